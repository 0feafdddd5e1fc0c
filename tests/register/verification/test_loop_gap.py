"""Folded cameras leave a gap that the matches of its two ends deny; those of a right model do not."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from helpers.camera_ring import ring_camera
from zeroshop_steps.geometry.cameras.pinhole import to_rigid
from zeroshop_steps.register.scene.record import Evidence
from zeroshop_steps.register.verification.loop_gap import GAP_DEG, check_loop_gap, estimate_turns, find_pairs_across_gap

COUNT, SIZE_PX, FOCAL_PX = 20, (640, 480), 700.0
UP = np.array([0.0, 0.0, 1.0])


def make_cameras(azimuths_deg):
    """Upright cameras at these azimuths around the origin."""
    cameras = [ring_camera(round(turn * 2), 720, 400.0, (10.0, 10.0), (0, 0, 0), FOCAL_PX, SIZE_PX) for turn in azimuths_deg]
    return {f"{number:06d}.png": camera for number, camera in enumerate(cameras)}


def turn_between(cameras, one, other):
    return cameras[other].camera_from_world[:3, :3] @ cameras[one].camera_from_world[:3, :3].T


def rotations_of(cameras):
    return {name: camera.camera_from_world[:3, :3] for name, camera in cameras.items()}


@pytest.fixture(scope="module")
def whole():
    return make_cameras(np.arange(COUNT) * 360 / COUNT)


@pytest.fixture(scope="module")
def folded():
    """Of an object that looks the same after half a turn."""
    return make_cameras((np.arange(COUNT) * 360 / COUNT + 90) % 180 - 90)


def test_the_ends_of_a_folded_circle_match_across_its_gap(whole, folded):
    near = {(one, other) for one in whole for other in whole if one < other and 0 < turn_deg(whole, one, other) <= 36}
    judged, beyond = find_pairs_across_gap(rotations_of(folded), UP, {pair: turn_between(whole, *pair) for pair in near})
    assert judged == 6 and len(beyond) >= 4
    assert all(turn_deg(folded, *pair) > 100 for pair in beyond)


def test_equal_sides_of_a_right_model_point_to_where_cameras_are(whole):
    names = sorted(whole)
    equal = {(names[k], names[k + COUNT // 2 + 1]): turn_between(whole, names[k], names[k + 1]) for k in range(COUNT // 2 - 1)}
    assert find_pairs_across_gap(rotations_of(whole), UP, equal) == (len(equal), ())


@pytest.mark.parametrize(("elevation_deg", "in_gap"), [(10.0, True), (25.0, True), (50.0, False), (-15.0, False)])
def test_pairs_that_match_one_equal_thing_to_another_point_to_where_no_camera_could_go_on(whole, elevation_deg, in_gap):
    """Two equal bags stand beside the object, turned differently: by their matches, a camera stands far above all others, or below."""
    half = {name: camera for name, camera in list(whole.items())[: COUNT // 2]}
    one, other = list(half)[0], list(half)[-3]
    said = ring_camera(675, 720, 400.0, (elevation_deg,) * 2, (0, 0, 0), FOCAL_PX, SIZE_PX).camera_from_world[:3, :3]
    turn = said @ half[one].camera_from_world[:3, :3].T
    judged, beyond = find_pairs_across_gap(rotations_of(half), UP, {(one, other): turn})
    assert judged == 1 and bool(beyond) == in_gap


def test_half_a_circle_of_an_object_without_equal_sides_says_nothing(whole):
    half = {name: camera for name, camera in list(whole.items())[: COUNT // 2]}
    pairs = {(one, other): turn_between(half, one, other) for one in half for other in half if one < other}
    assert find_pairs_across_gap(rotations_of(half), UP, pairs) == (0, ())


def turn_deg(cameras, one, other):
    return np.degrees(np.arccos(np.clip((np.trace(turn_between(cameras, one, other)) - 1) / 2, -1, 1)))


def write_matches(database: Path, cameras, points, pairs):
    """The keypoints that all cameras have of the same points, and verified matches of these pairs; returns the ids of the images."""
    lens = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=SIZE_PX[0], height=SIZE_PX[1], params=[FOCAL_PX, SIZE_PX[0] / 2, SIZE_PX[1] / 2], camera_id=1
    )
    ids = {}
    with pycolmap.Database.open(database) as opened:
        opened.write_camera(lens, use_camera_id=True)
        for number, (name, camera) in enumerate(cameras.items(), start=1):
            ids[name] = number
            opened.write_image(pycolmap.Image(name=name, camera_id=1, image_id=number), use_image_id=True)
            opened.write_keypoints(number, camera.project(points)[0].astype(np.float32))
        every = np.repeat(np.arange(len(points), dtype=np.uint32)[:, None], 2, axis=1)
        for one, other in pairs:
            geometry = pycolmap.TwoViewGeometry()
            geometry.config, geometry.inlier_matches = pycolmap.TwoViewGeometryConfiguration.CALIBRATED, every
            opened.write_two_view_geometry(ids[one], ids[other], geometry)
    return lens, ids


def make_model(lens, ids, cameras):
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(lens)
    for name, camera in cameras.items():
        image = pycolmap.Image(name=name, camera_id=1, image_id=ids[name])
        model.add_image_with_trivial_frame(image, to_rigid(camera.camera_from_world))
    return model


def test_a_folded_model_is_refused_and_the_right_one_is_not(whole, folded, tmp_path):
    points = np.random.default_rng(0).uniform(-60, 60, (80, 3))
    names = sorted(whole)
    across = [(names[k], names[k + 1]) for k in (4, 5)] + [(names[4], names[6]), (names[14], names[16])]
    lens, ids = write_matches(tmp_path / "database.db", whole, points, across)
    right, wrong = make_model(lens, ids, whole), make_model(lens, ids, folded)
    turns = estimate_turns(right, tmp_path / "database.db", across, 0)
    for pair, turn in zip(across, turns, strict=True):
        np.testing.assert_allclose(turn, turn_between(whole, *pair), atol=1e-3)
    assert check_loop_gap(right, right, tmp_path / "database.db", 0) == Evidence()
    found = check_loop_gap(wrong, wrong, tmp_path / "database.db", 0)
    assert found.findings[0].strength >= 1 and "no camera is within 1" in found.findings[0].found
    assert found.entries["gap_evidence"]["gap_deg"] > GAP_DEG and len(found.entries["gap_evidence"]["beyond"]) >= 2
