"""Pictures of detections and poses: one an image, with something drawn, and tiles of the worst estimates."""

from dataclasses import replace

import numpy as np

from helpers.small_dataset import true_estimates
from zeroshop_steps.bop.formats.detections import Detection, encode_mask, write_detections
from zeroshop_steps.bop.formats.estimates import write_estimates
from zeroshop_steps.bop.pictures import CAPTION_PX, ESTIMATED_COLOR, TILE_PX, TRUE_COLOR
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.runtime.cli import stage_main


def test_detections_poses_and_the_worst_are_drawn(dataset, capsys):
    folder = dataset.folder
    estimates = true_estimates(dataset)
    off = np.zeros((len(estimates), 1))
    off[0] = 25.0
    write_estimates(folder / "poses.csv", replace(estimates, translations_mm=estimates.translations_mm + off))
    frame = dataset.frames[1, 0]
    found = [Detection(1, 0, one.object_id, 0.5, None, encode_mask(frame.mask(index))) for index, one in enumerate(frame.instances)]
    write_detections(folder / "found.json", found)
    where = ["--scenes", dataset.scenes, "--targets", dataset.targets_path, "--models", folder / "models"]
    score = ["--method", "score_poses", *where, "--estimates", folder / "poses.csv", "--errors", "mssd", "mspd"]
    assert (
        stage_main("zeroshop_steps.bop", [*map(str, score), "--errors-out", str(folder / "errors.csv"), "--out", str(folder / "s.csv")])
        == 0
    )
    draw = ["--method", "pictures", *where, "--out", folder / "pictures"]
    given = ["--estimates", folder / "poses.csv", "--errors", folder / "errors.csv", "--detections", folder / "found.json"]
    assert stage_main("zeroshop_steps.bop", [*map(str, draw), *map(str, given)]) == 0
    picture, worst = read_image(folder / "pictures/000001_000000.png"), read_image(folder / "pictures/worst.png")
    assert picture.shape == (72, 2 * 96, 3) and picture[:, :96].any() and picture[:, 96:].any()
    assert worst.shape[0] == TILE_PX + CAPTION_PX and worst.shape[1] % TILE_PX == 0
    first = worst[:TILE_PX, :TILE_PX].reshape(-1, 3)
    assert all((first == color).all(1).any() for color in (TRUE_COLOR, ESTIMATED_COLOR)), "both outlines can be told apart"
    write_estimates(folder / "poses.csv", replace(estimates, **{name: getattr(estimates, name)[:0] for name in vars(estimates)}))
    write_detections(folder / "found.json", [replace(found[0], mask=encode_mask(np.zeros_like(frame.mask(0))))])
    assert (
        stage_main("zeroshop_steps.bop", [*map(str, score), "--errors-out", str(folder / "errors.csv"), "--out", str(folder / "none.csv")])
        == 0
    )
    assert stage_main("zeroshop_steps.bop", [*map(str, draw), *map(str, given)]) == 0, "without any estimate"
    assert not (folder / "pictures/worst.png").exists()
    (folder / "errors.csv").unlink()
    assert stage_main("zeroshop_steps.bop", [*map(str, draw), *map(str, given)]) == 1
    assert "errors.csv does not exist, and" in capsys.readouterr().err
    assert stage_main("zeroshop_steps.bop", list(map(str, draw))) == 1 and "nothing to draw" in capsys.readouterr().err
