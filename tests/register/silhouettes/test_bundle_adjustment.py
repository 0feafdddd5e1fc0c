"""Cameras that are a little off return to the true ones: the object's outlines and its tracks say how."""

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from helpers.camera_ring import ring_camera
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import to_rigid
from zeroshop_steps.register.silhouettes.bundle_adjustment import EXACT_MISS_PX, SilhouetteAdjustment
from zeroshop_steps.register.silhouettes.model_adjustment import adjust_model_by_masks
from zeroshop_steps.register.silhouettes.rays import look_up_many, make_outline_distance
from zeroshop_steps.register.silhouettes.state import NO_TRACKS, TrackKind, Tracks

SIZE_MM = (73.0, 28.0, 85.0)
FINER = 4  # the masks are drawn larger, and then thinned out
VIEWS, FOCAL_PX, WIDTH_PX, HEIGHT_PX = 10, 1260.0, 960, 720


@pytest.fixture(scope="module")
def views():
    """Cameras around a box on two heights, and its silhouettes."""
    cameras = [ring_camera(index, VIEWS, 300.0, (15.0, 50.0), (0.0, 0.0, 0.0), FOCAL_PX, (WIDTH_PX, HEIGHT_PX)) for index in range(VIEWS)]
    corners = np.array(list(itertools.product((-1, 1), repeat=3))) * SIZE_MM / 2
    masks = {}
    for camera in cameras:
        outline = cv2.convexHull(np.rint(camera.project(corners)[0] * FINER - 0.5).astype(np.int32))
        drawn = cv2.fillConvexPoly(np.zeros((HEIGHT_PX * FINER, WIDTH_PX * FINER), np.uint8), outline, 1)
        masks[camera.name] = cv2.resize(drawn.astype(np.float32), (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA) > 0.5
    return cameras, masks


def shaken(cameras, degrees, focal_factor):
    """The cameras turned about the object at random, with another focal length and as much farther away."""
    rng = np.random.default_rng(1)
    moved = []
    for camera in cameras:
        pose, intrinsics = camera.camera_from_world.copy(), camera.intrinsics.copy()
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(np.radians(rng.normal(scale=degrees, size=3))).as_matrix()
        pose[:3, 3] *= focal_factor
        intrinsics[:2, :2] *= focal_factor
        moved.append(replace(camera, camera_from_world=pose, intrinsics=intrinsics))
    return moved


def tracks_of(cameras, count, noise_px):
    """Points of the box, each in three views that follow each other."""
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.5, 0.5, (count, 3)) * SIZE_MM
    view = (rng.integers(0, VIEWS, count)[:, None] + np.arange(3)) % VIEWS
    pixels = np.stack([cameras[index].project(points[number][None])[0][0] for number, row in enumerate(view) for index in row])
    return Tracks(view.ravel(), np.repeat(np.arange(count), 3), pixels + rng.normal(scale=noise_px, size=pixels.shape))


def test_true_cameras_miss_almost_nothing(views):
    assert SilhouetteAdjustment(*views, NO_TRACKS).measure_misses_px().mean() < 0.3


def test_outlines_and_tracks_bring_shaken_cameras_back(views, few_rays):
    cameras, masks = views
    wrong = shaken(cameras, 1.0, 1.03)
    before = compare_cameras(wrong, cameras).centre_mm.mean()
    adjustment = SilhouetteAdjustment(wrong, masks, tracks_of(cameras, 100, 0.3))
    adjustment.adjust()
    adjusted = adjustment.adjusted_cameras()
    after = compare_cameras(adjusted, cameras).centre_mm.mean()
    assert before > 4.0 and after < 0.25 * before, (before, after)
    assert adjusted[0].intrinsics[0, 0] == pytest.approx(FOCAL_PX, rel=0.02)


def test_outlines_alone_come_to_agree(views, few_rays):
    """They leave a box of few views some freedom: not its cameras are asked here, but the outlines."""
    cameras, masks = views
    adjustment = SilhouetteAdjustment(shaken(cameras, 1.0, 1.0), masks, NO_TRACKS)
    before_px = adjustment.measure_misses_px().mean()
    adjustment.adjust()
    assert adjustment.measure_misses_px().mean() < 0.15 * before_px


def test_false_observations_hardly_matter(views, few_rays):
    cameras, masks = views
    tracks = tracks_of(cameras, 100, 0.3)
    pixels = tracks.pixels.copy()
    pixels[::15] += 25.0
    adjustment = SilhouetteAdjustment(shaken(cameras, 1.0, 1.0), masks, replace(tracks, pixels=pixels))
    adjustment.adjust()
    assert compare_cameras(adjustment.adjusted_cameras(), cameras).centre_mm.mean() < 1.5


def test_exact_tracks_count_more_than_rims(views):
    """Counted as one pixel each, rims that run along pixels pull the cameras away from tracks that are ten times as exact: 0.46 mm."""
    cameras, masks = views
    adjustment = SilhouetteAdjustment(shaken(cameras, 0.5, 1.01), masks, tracks_of(cameras, 200, 0.05))
    adjustment.adjust(TrackKind.ALIGNED)
    assert compare_cameras(adjustment.adjusted_cameras(), cameras).centre_mm.mean() < 0.3


def test_exact_tracks_count_even_more_than_the_rims_of_found_masks(views):
    """Masks that are two pixels too large all around hardly miss each other, but do not fit the tracks."""
    cameras, masks = views
    large = {name: cv2.dilate(mask.astype(np.uint8), np.ones((5, 5))) > 0 for name, mask in masks.items()}
    errors_mm = []
    for found in (False, True):
        adjustment = SilhouetteAdjustment(shaken(cameras, 0.5, 1.01), large, tracks_of(cameras, 200, 0.05))
        adjustment.adjust(TrackKind.ALIGNED, found)
        assert adjustment.measure_misses_px().mean() < EXACT_MISS_PX
        errors_mm.append(compare_cameras(adjustment.adjusted_cameras(), cameras).centre_mm.mean())
    assert errors_mm[1] < 0.7 * errors_mm[0], errors_mm


def test_a_view_whose_mask_lacks_a_side_stands_out(views, few_rays):
    """A network may cut off a side of the object that looks like the ground."""
    cameras, masks = views
    cut = masks[cameras[3].name].copy()
    cut[:, : int(np.flatnonzero(cut.any(axis=0))[0]) + 6] = False
    for given, standing_out in ((masks, []), (masks | {cameras[3].name: cut}, [3])):
        adjustment = SilhouetteAdjustment(shaken(cameras, 0.5, 1.01), given, tracks_of(cameras, 200, 0.05))
        adjustment.adjust(TrackKind.ALIGNED, found=True)
        assert adjustment.find_standing_out(adjustment.measure_misses_px()).tolist() == standing_out


def test_a_view_without_a_mask_is_held_by_its_tracks(views, few_rays):
    cameras, masks = views
    some = {name: mask for name, mask in masks.items() if name not in (cameras[2].name, cameras[7].name)}
    adjustment = SilhouetteAdjustment(shaken(cameras, 0.5, 1.0), some, tracks_of(cameras, 100, 0.3))
    assert set(adjustment.rays.view) == set(range(VIEWS)) - {2, 7}
    adjustment.adjust()
    assert compare_cameras(adjustment.adjusted_cameras(), cameras).centre_mm.max() < 3.0


def test_the_rim_lies_between_the_pixels():
    mask = np.zeros((40, 60), bool)
    mask[10:30, 20:40] = True
    distance = make_outline_distance(mask)
    across = look_up_many(distance, np.array([[19.0, 20.0], [20.0, 20.0], [21.0, 20.0], [30.0, 20.0]]))
    np.testing.assert_allclose(across, [-1.0, 0.0, 1.0, across[3]], atol=0.05)
    assert across[3] > 7


def test_points_that_come_to_lie_behind_a_camera_are_left_out(views):
    """Two rays that drift apart meet behind the cameras: such a point has no error, and no record can be written of it."""
    cameras, masks = views
    rng = np.random.default_rng(3)
    places = rng.uniform(-0.5, 0.5, (30, 3)) * SIZE_MM
    places[0] = 2.5 * (cameras[0].centre_in_world + cameras[1].centre_in_world) / 2
    pixels = np.stack([camera.project(places)[0] for camera in cameras])
    model = pycolmap.Reconstruction()
    lens = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=WIDTH_PX, height=HEIGHT_PX, params=[FOCAL_PX, WIDTH_PX / 2, HEIGHT_PX / 2], camera_id=1
    )
    model.add_camera_with_trivial_rig(lens)
    for number, camera in enumerate(cameras, start=1):
        image = pycolmap.Image(name=camera.name, keypoints=pixels[number - 1], camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, to_rigid(camera.camera_from_world))
    for index, place in enumerate(places):
        track = pycolmap.Track()
        for number in (1, 2) if index == 0 else range(1, VIEWS + 1):
            track.add_element(number, index)
        model.add_point3D(place, track, np.zeros(3, np.uint8))
    adjusted = adjust_model_by_masks(model, cameras, masks).model
    assert adjusted.num_points3D() == 29 and adjusted.compute_mean_reprojection_error() < 1.0
