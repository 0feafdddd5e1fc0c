"""An object without any print is registered by its outlines alone, from above and below; one that looks alike from all sides is refused."""

import itertools

import cv2
import numpy as np
import pytest

from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at, make_intrinsics
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.register import silhouette_sfm
from zeroshop_steps.register.features import sift
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.register.scene.record import RegistrationFailed
from zeroshop_steps.register.silhouette_sfm import LIKELY_PX, SilhouetteOptions, register
from zeroshop_steps.register.silhouettes import pose_search
from zeroshop_steps.register.silhouettes.coarse_coherence import measure_misses, try_places
from zeroshop_steps.register.silhouettes.epipolar_tangency import adjust_by_tangents
from zeroshop_steps.register.silhouettes.pose_alternatives import find_alternatives, mirror, replace_worst
from zeroshop_steps.register.silhouettes.pose_search import (
    ABOVE_DEG,
    ANYWHERE_DEG,
    GRID_DEG,
    PoseHypothesis,
    count_differing,
    make_cameras,
    make_places,
    prepare_outlines,
    read_hypothesis,
    search,
)

VIEWS, FOCAL_PX, DISTANCE_MM, SIZE_PX, FINER = 8, 1050.0, 330.0, (800, 600), 4
ARMS_MM = (((-50, -10, 0), (50, 10, 20)), ((20, -10, 0), (50, 60, 15)), ((-50, -12, 0), (-30, 12, 70)))
"""Corners of boxes: an object with arms of different lengths."""
WRONG_OF = 10
GUESSED_PX = np.full(VIEWS, 960.0)


def make_camera(index, rng, below=False, count=VIEWS):
    """A camera that is held by hand: not quite level, not at quite one distance, and anywhere around the object."""
    distance_mm = DISTANCE_MM * np.exp(rng.normal(scale=0.04))
    azimuth, elevation = 2 * np.pi * index / count + rng.uniform(-0.2, 0.2), np.radians(rng.uniform(12, 55))
    centre = distance_mm * direction_at(azimuth, -elevation if below else elevation)
    pose = look_at(centre + [0, 0, 25.0], np.array([0, 10.0, 25.0]) + rng.normal(scale=4.0, size=3))
    roll = rng.normal(scale=0.02)
    turn = np.array([[np.cos(roll), -np.sin(roll), 0, 0], [np.sin(roll), np.cos(roll), 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return Camera(f"{index:06d}.png", *SIZE_PX, make_intrinsics(FOCAL_PX, *SIZE_PX), turn @ pose)


def scale(cameras, unit_mm):
    """Cameras in another unit."""
    poses = [np.block([[c.camera_from_world[:3, :3], c.camera_from_world[:3, 3:] / unit_mm], [0, 0, 0, 1]]) for c in cameras]
    return [Camera(c.name, *SIZE_PX, c.intrinsics, pose) for c, pose in zip(cameras, poses, strict=True)]


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


@pytest.fixture
def narrow_beam(monkeypatch):
    """A quarter of the ways are kept: enough to find the views from below."""
    monkeypatch.setattr(pose_search, "PAIRS", pose_search.PAIRS // 4)
    monkeypatch.setattr(pose_search, "BEAM", tuple((least, max(6, width // 4)) for least, width in pose_search.BEAM))


@pytest.fixture
def coarse_features(monkeypatch):
    """Plain pictures have no features at any size, and are not searched for them at twice theirs."""
    monkeypatch.setattr(sift, "FINEST_OCTAVE", 0)


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


@pytest.fixture(scope="module")
def cameras_all_around():
    """Each third from below the object."""
    rng = np.random.default_rng(4)
    return [make_camera(index, rng, below=index % 3 == 1) for index in range(VIEWS)]


@pytest.fixture(scope="module")
def outlines_all_around(cameras_all_around):
    return prepare_outlines([draw_mask(camera, arms()) for camera in cameras_all_around], GUESSED_PX)


@pytest.mark.slow
def test_cameras_around_a_plain_object_are_found(cameras, masks_of_arms, tmp_path, narrow_beam, coarse_features):
    image_set = write_capture(tmp_path / "capture", masks_of_arms)
    (tmp_path / "out").mkdir()
    record = register(image_set, tmp_path / "out", SilhouetteOptions())
    error = compare_cameras(read_sparse_model(tmp_path / "out/sparse").cameras, cameras)
    assert len(error.names) == VIEWS and error.centre_mm.max() < 6.0, error
    assert error.focal_ratio == pytest.approx(1.0, abs=0.03)
    assert record["method"] == "outlines" and min(record["outlines"]["elsewhere_px"].values()) > 1.5


def test_no_place_is_given_up_that_is_among_the_best(cameras_all_around, outlines_all_around):
    views = read_hypothesis(scale(cameras_all_around, DISTANCE_MM), outlines_all_around, GUESSED_PX).views
    places, placed = make_places(ANYWHERE_DEG, GRID_DEG), np.arange(VIEWS - 1)
    whole, laid = try_places(VIEWS - 1, places, views, 0.0, placed, outlines_all_around, 2, len(places))
    costs, again = try_places(VIEWS - 1, places, views, 0.0, placed, outlines_all_around, 2, 5)
    best = np.argsort(whole)[:5]
    assert (costs <= whole).all() and (costs < whole).mean() > 0.5 and np.array_equal(laid, again)
    assert np.array_equal(costs[best], whole[best]) and np.delete(costs, best).min() >= whole[best].max()


@pytest.mark.slow
def test_right_cameras_of_an_object_of_revolution_fit_elsewhere_too(cameras, tmp_path):
    masks = {camera.name: draw_mask(camera, cone()) for camera in cameras}
    outlines = prepare_outlines(list(masks.values()), GUESSED_PX)
    scaled = scale(cameras, DISTANCE_MM)
    way = read_hypothesis(scaled, outlines, GUESSED_PX)
    # One such view is enough to refuse the cameras; the search for another place need not succeed in every view.
    assert (find_alternatives(way, outlines, ABOVE_DEG) < 1.0).sum() >= VIEWS - 2
    for camera, again in zip(scaled, make_cameras(way, outlines, write_capture(tmp_path, masks), GUESSED_PX), strict=True):
        np.testing.assert_allclose(again.camera_from_world, camera.camera_from_world, atol=1e-9)
        np.testing.assert_allclose(again.intrinsics, camera.intrinsics, atol=1e-6)


@pytest.mark.slow
def test_a_mask_of_another_object_is_set_aside(cameras, masks_of_arms, narrow_beam):
    masks = [masks_of_arms[camera.name] for camera in cameras]
    masks[5] = draw_mask(cameras[5], cone())
    outlines = prepare_outlines(masks, GUESSED_PX)
    order = [5, *np.random.default_rng(0).permutation(np.delete(np.arange(VIEWS), 5))][::-1]
    (way, *_), placed = search(outlines, order, ABOVE_DEG, most_misfits=1)
    assert way.cost < LIKELY_PX and placed.tolist() == np.delete(np.arange(VIEWS), 5).tolist()
    with_it, everything = search(outlines, order, ABOVE_DEG)
    assert with_it[0].cost > LIKELY_PX and len(everything) == VIEWS


@pytest.mark.slow
def test_views_from_below_are_placed(cameras_all_around, outlines_all_around, narrow_beam):
    truth = read_hypothesis(scale(cameras_all_around, DISTANCE_MM), outlines_all_around, GUESSED_PX)
    order = np.random.default_rng(0).permutation(VIEWS).tolist()
    assert search(outlines_all_around, order, ABOVE_DEG)[0][0].cost > LIKELY_PX
    found = replace_worst(search(outlines_all_around, order, ANYWHERE_DEG)[0][0], outlines_all_around, ANYWHERE_DEG)
    assert found.cost < LIKELY_PX and count_differing(truth, found) == 0, found


def test_a_view_on_a_wrong_side_is_mended(cameras_all_around, outlines_all_around):
    truth = read_hypothesis(scale(cameras_all_around, DISTANCE_MM), outlines_all_around, GUESSED_PX)
    wrong = PoseHypothesis(truth.views.copy(), truth.log_focal, 100.0)
    wrong.views[4, 0] += np.radians(150)
    wrong.views[4, 1] *= -1
    assert count_differing(truth, wrong) == 1
    mended = replace_worst(wrong, outlines_all_around, ANYWHERE_DEG)
    assert mended.cost < LIKELY_PX and count_differing(truth, mended) == 0, mended


def test_pictures_from_afar_do_not_tell_above_from_below(cameras_all_around, outlines_all_around):
    near = read_hypothesis(scale(cameras_all_around, DISTANCE_MM), outlines_all_around, GUESSED_PX)
    assert mirror(near, outlines_all_around).cost > LIKELY_PX
    farther, distant = 30.0, []
    for camera in cameras_all_around:
        pose, intrinsics = camera.camera_from_world.copy(), camera.intrinsics.copy()
        pose[2, 3] *= farther
        intrinsics[:2, :2] *= farther
        distant.append(Camera(camera.name, *SIZE_PX, intrinsics, pose))
    outlines = prepare_outlines([draw_mask(camera, arms()) for camera in distant], farther * GUESSED_PX)
    way = read_hypothesis(scale(distant, farther * DISTANCE_MM), outlines, farther * GUESSED_PX)
    turned = mirror(way, outlines)
    assert turned.cost < LIKELY_PX and count_differing(way, turned) > VIEWS / 2, turned.cost


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
        register(write_capture(tmp_path, masks), tmp_path / "out", SilhouetteOptions())


@pytest.mark.slow
def test_a_wrong_mask_is_left_out(tmp_path, monkeypatch, coarse_features):
    """Of ten, one shows less below, so that rays of others miss it. The search, which is tested above, places all views where they are."""
    rng = np.random.default_rng(4)
    cameras = [make_camera(index, rng, count=WRONG_OF) for index in range(WRONG_OF)]
    masks = {camera.name: draw_mask(camera, arms()) for camera in cameras}
    wrong = masks["000003.png"]
    below = int(np.median(np.flatnonzero(wrong.any(axis=1))))
    wrong[below:] = cv2.erode(wrong.astype(np.uint8), np.ones((13, 13)))[below:] > 0
    guessed_px = np.full(WRONG_OF, GUESSED_PX[0])
    way = read_hypothesis(scale(cameras, DISTANCE_MM), prepare_outlines(list(masks.values()), guessed_px), guessed_px)
    monkeypatch.setattr(silhouette_sfm, "search", lambda *_: ([way], np.arange(WRONG_OF)))
    (tmp_path / "out").mkdir()
    record = register(write_capture(tmp_path / "capture", masks), tmp_path / "out", SilhouetteOptions())
    assert set(record["outlines"]["wrong_px"]) == {"000003.png"} == set(record["unregistered"])
    error = compare_cameras(read_sparse_model(tmp_path / "out/sparse").cameras, cameras)
    assert len(error.names) == WRONG_OF - 1 and error.centre_mm.max() < 6.0, error
