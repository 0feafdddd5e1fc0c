"""Depth of an object that was captured twice, turned over between: from the captures of both passes to the measured surface."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.ball import RADIUS, ball_views
from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.geometry.cameras.pinhole import SparseModel
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.join.pass_images import Pass
from zeroshop_steps.join.passes import join_lenses
from zeroshop_steps.register.scene.depth_folder import DepthFolder
from zeroshop_steps.register.scene.undistortion import undistort_by_lens
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.surface.mvs.given_depth import read_given_depth

MM_A_UNIT, STEPS_MM = 150.0, {1: 1.0, 2: 0.25}
SIZE_PX = 96


@pytest.fixture
def passes(tmp_path, capsys):
    """Two passes of a ball, each of ten photos with depth, side by side; the second one's depth has finer steps."""
    views, truths = ball_views(SIZE_PX)
    known = {"source_names": [f"IMG_{number}.jpg" for number in range(10)], "width_px": SIZE_PX, "height_px": SIZE_PX}
    joint = []
    for index, (view, truth) in enumerate(zip(views, truths, strict=True)):
        number, place = 1 + index // 10, index % 10
        write_image(tmp_path / f"capture_{number}/images/{place:06d}.png", np.zeros((SIZE_PX, SIZE_PX, 3), np.uint8))
        mm = np.where(truth > 0, truth * MM_A_UNIT, 900.0)
        write_image(tmp_path / f"{number}/depth/IMG_{place}.png", np.rint(mm / STEPS_MM[number]).astype(np.uint16))
        camera = replace(view.camera, name=f"{number}_{place:06d}.png")
        joint.append((replace(view, camera=camera), View(camera, Path("none"), None, pass_number=number), truth))
    for number in STEPS_MM:
        write_json(tmp_path / f"capture_{number}/capture.json", known | {"scene": "video", "images": 10})
    lens = {"model": "PINHOLE", "width_px": SIZE_PX, "height_px": SIZE_PX, "params": [90.0, 90.0, SIZE_PX / 2, SIZE_PX / 2]}
    images = {f"IMG_{place}.jpg": {"lens": lens, "camera_from_world": None} for place in range(10)}
    write_json(tmp_path / "2/cameras.json", {"images": images, "depth_step_mm": STEPS_MM[2]})
    words = ["--method", "captures", "--captures", str(tmp_path / "capture_1"), str(tmp_path / "capture_2"), "--scene", "video_joined"]
    assert stage_main("zeroshop_steps.join", [*words, "--out", str(tmp_path / "joined")]) == 0, capsys.readouterr().err
    return joint


def find(tmp_path, registered, numbers=(1, 2)) -> DepthFolder:
    return DepthFolder.find({number: tmp_path / f"{number}/depth" for number in numbers}, registered, tmp_path, tmp_path / "joined", 1.0)


def test_depth_of_both_passes_measures_the_surface(passes, tmp_path) -> None:
    views, registered, truths = map(list, zip(*passes, strict=True))
    cameras = [view.camera for view in views]
    hull = VisualHull.carve(cameras, [view.mask.numpy() > 0 for view in views], 1.0, 48, misses_allowed=1)
    shown = np.random.default_rng(0).normal(size=(3000, 3))
    shown *= RADIUS / np.linalg.norm(shown, axis=1, keepdims=True)
    centres = [camera.centre_in_world for camera in cameras]
    seen = [np.flatnonzero(((c - shown) * shown).sum(1) > 0.5 * RADIUS * np.linalg.norm(c))[:40] for c in centres]
    model = SparseModel(tuple(cameras), shown, np.zeros((3000, 3), np.uint8), np.full(3000, 3), tuple(seen))
    sphere = ObjectSphere(np.zeros(3), 1.0)
    given = read_given_depth(find(tmp_path, registered), "structured_light", registered, model, sphere, views, hull)
    assert given is not None and given.figures["images"] == 20 and given.figures["mm_per_unit"] == pytest.approx(MM_A_UNIT, rel=2e-3)
    for depth, truth in zip(given.depths, truths, strict=True):
        small = truth[::3, ::3]
        assert (depth > 0).sum() > 0.5 * (small > 0).sum() and np.abs(depth - small)[depth > 0].max() < 0.1
    bare = replace(model, seen=(*seen[:10], *[np.zeros(0, int)] * 10))
    plain = read_given_depth(find(tmp_path, registered), "structured_light", registered, bare, sphere, views, hull)
    assert plain is not None and all(depth.any() for depth in plain.depths), "a plain second pass shows no sparse points"
    later = read_given_depth(find(tmp_path, registered, (2,)), "structured_light", registered, model, sphere, views, hull)
    assert later is not None and not any(depth.any() for depth in later.depths[:10]) and all(depth.any() for depth in later.depths[10:])


def test_depth_of_a_filmed_pass_is_refused(passes, tmp_path) -> None:
    record = read_json(tmp_path / "joined/capture.json")
    assert "source_names" not in record, "those of one pass alone are not those of all"
    record["sources_of_passes"][1] = {"source_frames": [0, 9]}
    write_json(tmp_path / "joined/capture.json", dict(record))
    with pytest.raises(StepError, match="depth images belong to photos"):
        find(tmp_path, [view for _, view, _ in passes])


def test_depth_is_undistorted_by_the_lens_of_its_own_pass(passes, tmp_path) -> None:
    registered = [view for _, view, _ in passes]
    lens = {"model": "SIMPLE_RADIAL", "width_px": SIZE_PX, "height_px": SIZE_PX, "params": [90.0, SIZE_PX / 2, SIZE_PX / 2, 0.3]}
    images = {number: {f"{number}_{i:06d}.png": tmp_path / f"{i:06d}.png" for i in range(10)} for number in STEPS_MM}
    both = [Pass(number, None, images[number], {}) for number in STEPS_MM]
    write_json(tmp_path / "registration.json", join_lenses({1: {}, 2: {"lens": lens}}, both))
    folder = find(tmp_path, registered)
    for view in (registered[3], registered[13]):
        raw = cv2.imread(str(tmp_path / f"{view.pass_number}/depth/IMG_3.png"), cv2.IMREAD_UNCHANGED) * STEPS_MM[view.pass_number]
        own = lens if view.pass_number == 2 else None
        assert np.allclose(folder.read_mm(view), undistort_by_lens(raw.astype(np.float32), own, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT))
        assert (folder.read_mm(view) != raw).any() == (view.pass_number == 2)
