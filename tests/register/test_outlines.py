"""An object without any print is registered by its outlines alone; one that looks the same from all sides is refused."""

import itertools

import cv2
import numpy as np
import pytest

from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras import Camera, read_sparse_model
from zeroshop_steps.geometry.images import write_image, write_mask
from zeroshop_steps.geometry.viewpoints import direction_at, look_at, make_intrinsics
from zeroshop_steps.register.image_set import read_image_set
from zeroshop_steps.register.outline_coherence import measure_misses
from zeroshop_steps.register.outline_search import find_alternatives, prepare_outlines
from zeroshop_steps.register.outline_tangents import adjust_by_tangents
from zeroshop_steps.register.outlines import OutlineOptions, make_cameras, read_way, register
from zeroshop_steps.register.record import RegistrationFailed

VIEWS, FOCAL_PX, SIZE_PX, FINER = 8, 1050.0, (800, 600), 4
ARMS_MM = (((-50, -10, 0), (50, 10, 20)), ((20, -10, 0), (50, 60, 15)), ((-50, -12, 0), (-30, 12, 70)))
"""Corners of boxes: an object with arms of different lengths."""
GUESSED_PX = np.full(VIEWS, 960.0)


def make_camera(index, rng):
    """A camera that is held by hand: not quite level, not at quite one distance, and anywhere around the object."""
    distance_mm = 330.0 * np.exp(rng.normal(scale=0.04))
    centre = distance_mm * direction_at(2 * np.pi * index / VIEWS + rng.uniform(-0.2, 0.2), np.radians(rng.uniform(12, 55)))
    pose = look_at(centre + [0, 0, 25.0], np.array([0, 10.0, 25.0]) + rng.normal(scale=4.0, size=3))
    roll = rng.normal(scale=0.02)
    turn = np.array([[np.cos(roll), -np.sin(roll), 0, 0], [np.sin(roll), np.cos(roll), 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return Camera(f"{index:06d}.png", *SIZE_PX, make_intrinsics(FOCAL_PX, *SIZE_PX), turn @ pose)


def draw_mask(camera, hulls):
    """The silhouette of the union of convex bodies, given by (P, 3) points each."""
    drawn = np.zeros((SIZE_PX[1] * FINER, SIZE_PX[0] * FINER), np.uint8)
    for points in hulls:
        outline = cv2.convexHull(np.rint(camera.project(points)[0] * FINER - 0.5).astype(np.int32))
        drawn |= cv2.fillConvexPoly(np.zeros_like(drawn), outline, 1)
    return cv2.resize(drawn.astype(np.float32), SIZE_PX, interpolation=cv2.INTER_AREA) > 0.5


@pytest.fixture(scope="module")
def cameras():
    rng = np.random.default_rng(4)
    return [make_camera(index, rng) for index in range(VIEWS)]


def arms():
    return [np.array(list(itertools.product(*zip(*box, strict=True))), float) for box in ARMS_MM]


def cone():
    """An object of revolution."""
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rings = [(45.0, 0.0), (50.0, 20.0), (25.0, 60.0)]
    return [np.concatenate([np.stack([r * np.cos(angles), r * np.sin(angles), np.full(200, z)], 1) for r, z in rings])]


def write_capture(folder, masks):
    """Plain pictures."""
    for name, mask in masks.items():
        write_image(folder / "images" / name, np.where(mask, 190, 60).astype(np.uint8)[..., None].repeat(3, axis=2))
        write_mask(folder / "masks" / name, mask)
    return read_image_set(folder)


@pytest.fixture(scope="module")
def masks_of_arms(cameras):
    return {camera.name: draw_mask(camera, arms()) for camera in cameras}


@pytest.mark.slow
def test_cameras_around_a_plain_object_are_found(cameras, masks_of_arms, tmp_path):
    image_set = write_capture(tmp_path / "capture", masks_of_arms)
    (tmp_path / "out").mkdir()
    record = register(image_set, tmp_path / "out", OutlineOptions())
    error = compare_cameras(read_sparse_model(tmp_path / "out/sparse").cameras, cameras)
    assert len(error.names) == VIEWS and error.centre_mm.max() < 6.0, error
    assert error.focal_ratio == pytest.approx(1.0, abs=0.03)
    assert record["method"] == "outlines" and min(record["outlines"]["elsewhere_px"].values()) > 1.5


@pytest.mark.slow
def test_right_cameras_of_an_object_of_revolution_fit_elsewhere_too(cameras, tmp_path):
    masks = {camera.name: draw_mask(camera, cone()) for camera in cameras}
    outlines = prepare_outlines(list(masks.values()), GUESSED_PX)
    scaled = [
        Camera(c.name, *SIZE_PX, c.intrinsics, np.block([[c.camera_from_world[:3, :3], c.camera_from_world[:3, 3:] / 330], [0, 0, 0, 1]]))
        for c in cameras
    ]
    way = read_way(scaled, outlines, GUESSED_PX)
    # One such view is enough to refuse the cameras; the search for another place need not succeed in every view.
    assert (find_alternatives(way, outlines) < 1.0).sum() >= VIEWS - 2
    for camera, again in zip(scaled, make_cameras(way, outlines, write_capture(tmp_path, masks), GUESSED_PX), strict=True):
        np.testing.assert_allclose(again.camera_from_world, camera.camera_from_world, atol=1e-9)
        np.testing.assert_allclose(again.intrinsics, camera.intrinsics, atol=1e-6)


@pytest.mark.slow
def test_tangents_bring_shaken_views_back(masks_of_arms):
    outlines = prepare_outlines(list(masks_of_arms.values()), GUESSED_PX)
    rng = np.random.default_rng(0)
    azimuths = 2 * np.pi * np.arange(VIEWS) / VIEWS
    views = np.zeros((VIEWS, 6))
    views[:, 0], views[:, 1] = azimuths + rng.normal(scale=0.05, size=VIEWS), 0.6
    placed, free = np.arange(VIEWS), np.ones(VIEWS, bool)
    before_px, log_focal = measure_misses(views, 0.0, placed, outlines, 1).mean(), 0.0
    for tolerance in (0.15, 0.05, 0.02):
        views, log_focal, _ = adjust_by_tangents(views, log_focal, placed, outlines, tolerance, 20, True, free)
    after_px = measure_misses(views, log_focal, placed, outlines, 1).mean()
    assert before_px > 10.0 and after_px < 1.0, (before_px, after_px)


def test_an_object_that_is_cut_off_is_refused(masks_of_arms, tmp_path):
    first = next(iter(masks_of_arms))
    masks = {name: mask.copy() for name, mask in masks_of_arms.items()}
    masks[first][:, :200] = True
    with pytest.raises(RegistrationFailed, match=f"cut off in 1, such as {first}"):
        register(write_capture(tmp_path, masks), tmp_path / "out", OutlineOptions())
