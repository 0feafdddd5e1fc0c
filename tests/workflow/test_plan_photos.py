"""What `snakemake -n` plans for photos."""

import json

import numpy as np
import pytest

from helpers.plans import PHOTO_CELL, photo_table
from helpers.pretend import pretend
from helpers.running import planned


def test_photos(snakemake, tmp_path):
    for name in ("images", "masks"):
        (tmp_path / "my cup" / name).mkdir(parents=True)
        (tmp_path / "my cup" / name / "a.png").touch()
    table = photo_table(tmp_path, tmp_path / "my cup/images", tmp_path / "my cup/masks", "0.12")
    run = snakemake("-n", "results/photos/cup/2dgs.ply", *table)
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["capture_photos", "register_photos", "segment", *PHOTO_CELL], 1)
    assert "--images 'my cup/images' --masks 'my cup/masks'" in run.stdout


@pytest.mark.parametrize("place", ["cup", "results/imported/cup"], ids=["own", "imported"])
def test_photos_that_bring_their_cameras(snakemake, tmp_path, place):
    """They are registered by these, whatever the config chooses for others, and take the height from them unless it is given."""
    (tmp_path / place / "images").mkdir(parents=True)
    for path in (f"{place}/images/a.png", "can.mp4"):
        (tmp_path / path).touch()
    lens = {"model": "PINHOLE", "width_px": 64, "height_px": 48, "params": [60.0, 60.0, 32.0, 24.0]}
    given = {f"{name}.png": {"lens": lens, "camera_from_world": np.eye(4).tolist()} for name in "abc"}
    (tmp_path / place / "cameras.json").write_text(json.dumps({"images": given}))
    table = tmp_path / "objects.tsv"
    header = "dataset\tobject\timages\tmasks\theight_m\tcameras"
    images, cameras = tmp_path / place / "images", tmp_path / place / "cameras.json"
    table.write_text(f"{header}\nphotos\tcup\t{images}\t\t\t{cameras}\nphotos\tmug\t{images}\t\t0.1\t{cameras}\n")
    run = snakemake("-n", "-p", "results/photos/cup/2dgs.ply", "--config", f"objects_table={table}")
    assert run.returncode == 0, run.stdout
    assert f"--cameras {place}/cameras.json" in run.stdout and "--method given " in run.stdout and "--height given_cameras" in run.stdout
    run = snakemake("-n", "-p", "results/photos/mug/2dgs.ply", "--config", f"objects_table={table}")
    assert "--method given " in run.stdout and "--height known " in run.stdout
    table.write_text(f"{header}\nphotos\tcan\t{tmp_path}/can.mp4\t\t\t{cameras}\n")
    run = snakemake("-n", "results/photos/can/2dgs.ply", "--config", f"objects_table={table}")
    assert run.returncode != 0 and "a video has no cameras" in run.stdout


@pytest.mark.slow
def test_the_row_of_a_photographed_cell_is_its_grade_alone(snakemake, tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images/a.png").touch()
    cell = "results/photos/cup/video/colmap/2dgs"
    pretend(lambda *words: snakemake(*words, *photo_table(tmp_path, tmp_path / "images", "")), tmp_path, f"{cell}/cell.csv")
    assert (tmp_path / cell / "grade.csv").exists() and not (tmp_path / cell / "quality.csv").exists()


@pytest.mark.slow
def test_photos_registered_by_the_object_alone(snakemake, tmp_path):
    """Given masks are there before anything is registered; without weights, others are found in the registered whole scene."""
    for name in ("images", "masks"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.png").touch()
    chosen = "chosen={photos: {scene: video_segmented}}"
    run = snakemake("-n", "results/photos/cup/2dgs.ply", *photo_table(tmp_path, tmp_path / "images", tmp_path / "masks"), chosen)
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["capture_photos", "capture_object", "register_photos", "segment", *PHOTO_CELL], 1)
    assert "--pictures results/photos/cup/video/capture " in run.stdout and "--scene video_segmented" in run.stdout
    run = snakemake("-n", "results/photos/cup/2dgs.ply", *photo_table(tmp_path, tmp_path / "images", ""), chosen)
    assert run.returncode == 0, run.stdout
    twice = dict.fromkeys(["register_photos", "segment"], 2)
    assert planned(run.stdout) == dict.fromkeys(["capture_photos", "capture_object", *PHOTO_CELL], 1) | twice
    assert "--pictures results/photos/cup/video/auto/cameras " in run.stdout
    assert "--method support_plane --scene results/photos/cup/video/auto/scene" in run.stdout
    assert "--method user_masks --scene results/photos/cup/video_segmented/auto/scene" in run.stdout


def test_a_capture_takes_as_many_pictures_as_its_row_says(snakemake, tmp_path):
    """Frames of a film, and half as many again in between; photos of a folder at most."""
    (tmp_path / "images").mkdir()
    for path in ("images/a.png", "can.mp4"):
        (tmp_path / path).touch()
    table = tmp_path / "objects.tsv"
    header = "dataset\tobject\timages\tmasks\theight_m\tpicture_count"
    table.write_text(f"{header}\nphotos\tcan\t{tmp_path}/can.mp4\t\t\t61\nphotos\tbox\t{tmp_path}/images\t\t\t100\n")
    targets = [f"results/photos/{name}/video/capture" for name in ("can", "box")]
    run = snakemake("-n", *targets, "--config", f"objects_table={table}")
    assert run.returncode == 0, run.stdout
    assert "--frames 61 --spacing view --most-frames 92" in run.stdout and "--most-images 100" in run.stdout


def test_several_objects_share_photos_and_cameras(snakemake, tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images/a.png").touch()
    table = tmp_path / "objects.tsv"
    rows = [f"photos\t{name}\t{tmp_path}/images\t\t\t{owner}" for name, owner in (("shelf", "\t"), ("cup", "shelf\t2"))]
    table.write_text("\n".join(["dataset\tobject\timages\tmasks\theight_m\tscene_of\tnumber", *rows, ""]))
    run = snakemake("-n", "results/photos/cup/2dgs.ply", "--config", f"objects_table={table}")
    assert run.returncode == 0, run.stdout
    shared = ["capture_photos", "register_photos", "share_capture", "share_scene", "list_objects"]
    assert planned(run.stdout) == dict.fromkeys([*shared, "segment", *PHOTO_CELL], 1)
    assert "--objects results/photos/shelf/video/auto/objects/objects.json --number 2" in run.stdout
    table.write_text(table.read_text().replace("shelf\t2", "shop\t2"))
    run = snakemake("-n", "results/photos/cup/2dgs.ply", "--config", f"objects_table={table}")
    assert run.returncode != 0 and "photos cup: scene_of names shop, which is no object of photos with photos of its own" in run.stdout
