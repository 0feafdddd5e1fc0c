"""An object on a turntable before a background that stands still: its cameras are found all the same, and the user is told."""

from itertools import combinations

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import list_images, read_depth_mm, read_image, write_image
from zeroshop_steps.register.matching.turntable import measure_stationary, verify_without_stationary
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json


def turn_before_background(capture, out, radius_mm: float) -> None:
    """Keep what is within a radius of the axis; all else becomes one background."""
    blocks = np.random.default_rng(7).integers(0, 255, (90, 120, 3), dtype=np.uint8)
    cameras = {camera.name: camera for camera in read_sparse_model(capture / "truth").cameras}
    for path in list_images(capture / "images"):
        image, depth, camera = read_image(path), read_depth_mm(capture / "depth" / path.name), cameras[path.name]
        rows, columns = np.indices(depth.shape) + 0.5
        rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(camera.intrinsics).T
        world = np.linalg.inv(camera.camera_from_world)
        points = (rays * depth[..., None]) @ world[:3, :3].T + world[:3, 3]
        turns = (depth > 0) & (np.hypot(points[..., 0], points[..., 1]) < radius_mm)
        still = cv2.resize(blocks, image.shape[1::-1], interpolation=cv2.INTER_CUBIC)
        write_image(out / "images" / path.name, np.where(turns[..., None], image, still))


@pytest.mark.parametrize(("still", "background"), [(0, False), (2, False), (3, True), (66, True)])
def test_a_few_pairs_that_stand_still_tell_a_background(tmp_path, still, background):
    """Of 66 pairs, the matches of the first ones do not move; two may be photos that were taken twice from one place."""
    count, matched = 12, np.tile(np.arange(40, dtype=np.uint32)[:, None], (1, 2))
    names = [f"{number}.png" for number in range(count)]
    with pycolmap.Database.open(tmp_path / "d.db") as opened:
        lens = opened.write_camera(pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 1000.0, 1000, 750))
        place = np.random.default_rng(0).uniform(100, 600, (40, 2))
        ids = [opened.write_image(pycolmap.Image(name=name, camera_id=lens)) for name in names]
        pairs = list(combinations(range(count), 2))
        moves = {pair: number >= still for number, pair in enumerate(pairs)}
        for number, image in enumerate(ids):
            # Those of pairs that stand still come first, those of the others then.
            opened.write_keypoints(image, np.concatenate([place, place + 20.0 * number]).astype(np.float32))
        for (first, second), moved in moves.items():
            matches = matched + 40 * np.uint32(moved)
            opened.write_two_view_geometry(ids[first], ids[second], pycolmap.TwoViewGeometry(inlier_matches=matches))
    images = ImageSet(tuple(tmp_path / name for name in names), None, ((1000, 750),) * count)
    found = measure_stationary(tmp_path / "d.db", images)
    assert found.are_background == background
    if background:
        assert "stands still" in found.describe() and ("in 5% of the pairs" in found.describe()) == (still == 3)


@pytest.mark.parametrize("turntable", [True, False])
def test_a_background_that_only_shifts_is_told_and_left_out(tmp_path, turntable):
    """Photos that were cropped around the object: the background moves in them, but not as the object turns."""
    rng, count, focal_px = np.random.default_rng(3), 6, 1500.0
    thing, far = rng.uniform(-1, 1, (90, 3)), rng.uniform(-1, 1, (60, 3)) * [4, 3, 2]
    names = [f"{number}.png" for number in range(count)]
    with pycolmap.Database.open(tmp_path / "d.db") as opened:
        lens = opened.write_camera(pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", focal_px, 1000, 750))
        ids = [opened.write_image(pycolmap.Image(name=name, camera_id=lens)) for name in names]
        for number, image in enumerate(ids):
            from_above, turn = Rotation.from_euler("x", 30, degrees=True), Rotation.from_euler("y", 9 * number, degrees=True)
            turned = (from_above * turn).apply(thing)
            seen = np.concatenate([turned, far if turntable else (from_above * turn).apply(far)]) + [0, 0, 8]
            crop_px = np.array([500, 375]) + ([17 * number, -9 * number] if turntable else [0, 0])
            opened.write_keypoints(image, (focal_px * seen[:, :2] / seen[:, 2:] + crop_px).astype(np.float32))
        every = np.tile(np.arange(150, dtype=np.uint32)[:, None], (1, 2))
        for first, second in combinations(ids, 2):
            opened.write_matches(first, second, every)
            opened.write_two_view_geometry(first, second, pycolmap.TwoViewGeometry(inlier_matches=every))
    images = ImageSet(tuple(tmp_path / name for name in names), None, ((1000, 750),) * count)
    found = measure_stationary(tmp_path / "d.db", images)
    assert found.are_background == turntable and (found.apart > 0.9) == turntable and found.share < 0.1
    if turntable:
        assert "moves otherwise than the rest" in found.describe()
        verify_without_stationary(tmp_path / "d.db", images, seed=0)
        with pycolmap.Database.open(tmp_path / "d.db") as opened:
            pairs = opened.read_two_view_geometries()[1]
        own = [(pair.inlier_matches[:, 0] < len(thing)).mean() for pair in pairs]
        assert len(pairs) == 15 and min(own) > 0.98 and min(len(pair.inlier_matches) for pair in pairs) > 60


@pytest.mark.slow
def test_cameras_follow_what_turns(carton_capture, tmp_path, capsys):
    capture, out = tmp_path / "capture", tmp_path / "cameras"
    turn_before_background(carton_capture, capture, 110.0)
    words = ("--method", "colmap", "--capture", capture, "--scene", "video", "--out", out, "--max-features", 2000)
    assert stage_main("zeroshop_steps.register", [str(word) for word in words]) == 0
    assert "the background stands still" in capsys.readouterr().err
    record = read_json(out / "registration.json")
    assert record["still_share"] > 0.3 and record["still_background"]
    error = compare_cameras(read_sparse_model(out / "sparse").cameras, read_sparse_model(carton_capture / "truth").cameras)
    assert len(error.names) == 10 and error.centre_mm.mean() < 2.0


@pytest.mark.slow
def test_too_little_that_turns_is_told_with_a_way_out(carton_capture, tmp_path, capsys):
    turn_before_background(carton_capture, tmp_path / "capture", 12.0)
    words = (
        "--method",
        "colmap",
        "--capture",
        tmp_path / "capture",
        "--scene",
        "video",
        "--out",
        tmp_path / "cameras",
        "--max-features",
        500,
    )
    assert stage_main("zeroshop_steps.register", [str(word) for word in words]) == 1
    message = capsys.readouterr().err
    assert "the background stands still" in message and "too little to find the cameras" in message and "video_segmented" in message
    assert not (tmp_path / "cameras").exists()
