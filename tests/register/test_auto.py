"""One registration after the other: the first that succeeds gives the cameras, and the record says why those before it did not."""

import argparse
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from helpers.ball_scene import ball_cameras, ball_mask, write_ball_scene
from helpers.small_saliency import NORMALIZATION, write_network
from zeroshop_steps.evaluate.mask_error import undistort_mask
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model, write_cameras
from zeroshop_steps.geometry.imaging.images import compute_overlap, read_mask
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register import auto
from zeroshop_steps.register.camera_proposals import Proposer, propose
from zeroshop_steps.register.scene.image_set import read_masks
from zeroshop_steps.register.scene.record import RegistrationFailed
from zeroshop_steps.runtime.errors import StepError

LENS = {"model": "SIMPLE_RADIAL", "width_px": 160, "height_px": 120, "params": [170.0, 80.0, 60.0, 0.5]}


def register(out, attempts):
    """Proposals of these names, each of which is asked anyway."""
    return propose(out, [Proposer(name, lambda folder, _, fill=fill: fill(folder)) for name, fill in attempts.items()])


def succeed(folder):
    (folder / "images").mkdir()
    (folder / "images" / "0.png").touch()
    return {"method": "found", "registered": 20}


def fail(registered):
    def attempt(folder):
        (folder / "images").mkdir()
        raise RegistrationFailed(f"{registered} of 20 images registered", {"registered": registered})

    return attempt


@pytest.fixture
def out(tmp_path):
    (tmp_path / "cameras").mkdir()
    return tmp_path / "cameras"


def test_what_succeeds_first_is_kept_and_nothing_else_runs(out):
    record = register(out, {"colmap": succeed, "aliked": fail(0)})
    assert record == {"method": "found", "registered": 20, "tried": {}}
    assert [path.name for path in out.rglob("*.png")] == ["0.png"] and [path.name for path in out.parent.iterdir()] == ["cameras"]


def test_the_next_is_tried_and_the_record_says_why(out):
    record = register(out, {"colmap": fail(3), "aliked": succeed})
    assert record["method"] == "found" and record["tried"]["colmap"]["reason"] == "3 of 20 images registered"
    assert record["tried"]["colmap"]["seconds"] >= 0 and (out / "images/0.png").is_file()


def place(registered, shift=0.0):
    """An attempt that registers so many images of a ball's; `shift` moves every other camera."""

    def attempt(folder):
        cameras = list(ball_cameras())[:registered]
        for camera in cameras[::2]:
            camera.camera_from_world[:3, 3] += shift
        write_cameras(folder / "sparse", cameras)
        return {"method": f"with {registered}", "registered": registered, "images": 12}

    return attempt


def test_where_many_images_are_left_out_the_next_is_taken_if_it_has_more_and_agrees(out):
    record = register(out, {"colmap": place(6), "aliked": place(11), "outlines": place(12)})
    assert record["method"] == "with 11" and set(record["tried"]) == {"colmap"}
    assert record["tried"]["colmap"]["reason"] == "6 of 12 images registered"
    assert len(read_sparse_model(out / "sparse").cameras) == 11


def test_where_the_next_has_no_more_the_first_is_kept(out):
    for name, other in (("fewer", place(5)), ("fails", fail(0))):
        (out / name).mkdir()
        record = register(out / name, {"colmap": place(6), "aliked": other})
        assert record["method"] == "with 6" and set(record["tried"]) == {"aliked"} and "warnings" not in record
        assert len(read_sparse_model(out / name / "sparse").cameras) == 6


def test_cameras_that_contradict_each_other_are_told(out):
    record = register(out, {"colmap": place(6), "aliked": place(12, shift=0.3)})
    assert record["method"] == "with 6" and "contradict each other" in record["warnings"][0]
    assert "contradict" in record["tried"]["aliked"]["reason"]


def test_where_all_fail_both_reasons_are_told_and_nothing_is_left(out):
    with pytest.raises(RegistrationFailed, match="by colmap: 3 of 20 .*; by aliked: 5 of 20") as error:
        register(out, {"colmap": fail(3), "aliked": fail(5)})
    assert error.value.figures["registered"] == 5 and set(error.value.figures["tried"]) == {"colmap", "aliked"}
    assert not list(out.iterdir())


def test_without_weights_the_reason_says_how_to_get_them(blank_capture, tmp_path, monkeypatch):
    monkeypatch.setattr(auto.silhouette_sfm, "register", lambda image_set, folder, **options: fail(0)(folder))
    parser = argparse.ArgumentParser()
    auto.add_arguments(parser)
    words = ["--capture", blank_capture, "--scene", "su_l", "--out", tmp_path / "cameras", "--weights", tmp_path / "nowhere"]
    with pytest.raises(RegistrationFailed) as error:
        auto.run(parser.parse_args(list(map(str, words))))
    for part in (
        "0 of 10 images registered",
        "snakemake resources/weights/aliked/{aliked-n16.pth,aliked_lightglue.pth}",
        "50 MB",
        "Apache-2.0",
    ):
        assert part in str(error.value)


@dataclass
class BallPhotos:
    """Photos of a ball without masks, and a network that finds it; what registers the masked ball keeps the masks in `taken`."""

    folder: Path
    taken: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        write_ball_scene(self.folder / "capture")
        write_network(self.folder / "saliency.onnx")
        for name in (auto.EXTRACTOR, auto.MATCHER):
            (self.folder / name).touch()
        (self.folder / "cameras").mkdir()

    def register(self, image_set, folder, **options):
        self.taken.extend(read_masks(image_set).values())
        write_cameras(folder / "sparse", list(ball_cameras()))
        return succeed(folder) | {"lens": LENS}

    def run(self, monkeypatch, network="saliency.onnx"):
        """The record of `auto`, where `colmap` fails."""
        records = []
        monkeypatch.setattr(auto.colmap, "make_proposers", lambda *_: [Proposer("colmap", lambda folder, _: fail(3)(folder))])
        monkeypatch.setattr(auto, "write_registration", lambda out, run: records.append(run(out)))
        parser = argparse.ArgumentParser()
        auto.add_arguments(parser)
        words = ["--capture", self.folder / "capture", "--scene", "video", "--out", self.folder / "cameras", "--weights", self.folder]
        auto.run(parser.parse_args([*map(str, words), "--network", str(self.folder / network), *NORMALIZATION]))
        return records[0]

    def has_found_masks(self):
        return all(compute_overlap(mask, ball_mask(camera)) > 0.95 for mask, camera in zip(self.taken, ball_cameras(), strict=True))


def test_photos_without_masks_get_them_by_a_network(tmp_path, monkeypatch):
    ball = BallPhotos(tmp_path)
    monkeypatch.setattr(auto.aliked, "register", ball.register)
    record = ball.run(monkeypatch)
    assert record["masks_by"] == "saliency.onnx" and record["tried"]["colmap"]["reason"] == "3 of 20 images registered"
    assert ball.has_found_masks()
    kept = sorted(path.name for path in (tmp_path / "cameras/saliency").iterdir())
    assert kept == [*(f"{index:06d}.png" for index in range(12)), "finder.json"]
    seen = read_mask(tmp_path / "cameras/saliency/000003.png")
    assert compute_overlap(seen, undistort_mask(ball.taken[3], LENS)) > 0.97 > compute_overlap(seen, ball.taken[3])
    with pytest.raises(StepError, match="missing.onnx does not exist"):
        ball.run(monkeypatch, "missing.onnx")


def test_outlines_are_tried_with_the_masks_of_a_network_which_looks_once(tmp_path, monkeypatch):
    ball, looked, find_maps = BallPhotos(tmp_path), [], SalientObjectNetwork.find_maps
    monkeypatch.setattr(SalientObjectNetwork, "find_maps", lambda *asked: looked.append(asked) or find_maps(*asked))
    monkeypatch.setattr(auto.aliked, "register", lambda image_set, folder, **options: fail(5)(folder))
    monkeypatch.setattr(auto.silhouette_sfm, "register", ball.register)
    record = ball.run(monkeypatch)
    assert len(looked) == 1 and set(record["tried"]) == {"colmap", "aliked"} and record["masks_by"] == "saliency.onnx"
    assert ball.has_found_masks()


def test_without_masks_and_network_the_reason_says_what_would_help(tmp_path):
    write_ball_scene(tmp_path / "capture")
    parser = argparse.ArgumentParser()
    auto.add_arguments(parser)
    words = ["--capture", tmp_path / "capture", "--scene", "video", "--out", tmp_path / "cameras", "--weights", tmp_path / "nowhere"]
    with pytest.raises(
        RegistrationFailed, match=r"they need their weights, .*Masks of the object help them, .*saliency/u2netp\.onnx` downl"
    ):
        auto.run(parser.parse_args(list(map(str, words))))
