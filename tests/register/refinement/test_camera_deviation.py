"""The deviations that a registration states are those that its cameras have when the same views are observed again with other errors."""

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest

from helpers.camera_ring import ring_camera
from zeroshop_steps.evaluate.camera_error import measure_object_errors_px
from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.geometry.cameras.pinhole import to_matrix, to_rigid
from zeroshop_steps.geometry.cameras.registered_views import DEVIATIONS, read_deviations, read_views
from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.geometry.cameras.transforms import move_similarity, transform_camera, transform_points
from zeroshop_steps.register.mapping.mapper import adjust_robustly
from zeroshop_steps.register.refinement.camera_deviation import (
    LOOSE,
    _invert_root,
    estimate_deviations,
    measure_deviations,
    write_deviations,
)
from zeroshop_steps.register.registration import write_registration
from zeroshop_steps.register.silhouettes.bundle_adjustment import SilhouetteAdjustment
from zeroshop_steps.register.silhouettes.model_adjustment import read_tracks
from zeroshop_steps.register.silhouettes.state import NO_TRACKS, Tracks
from zeroshop_steps.runtime.files import read_json

VIEWS, FOCAL_PX, SIZE_PX, RADIUS_MM = 8, 1260.0, (960, 720), 60.0
FEW, NOISY = 3, 6
"""Two views of the ring: of the one, most observations are missing; those of the other are three times as noisy."""


@pytest.fixture(scope="module")
def scene():
    """Points of a box, each in four views that follow each other: cameras, points, observations, and the noise of each."""
    rng = np.random.default_rng(3)
    cameras = [ring_camera(index, VIEWS, 300.0, (15.0, 50.0), (0.0, 0.0, 0.0), FOCAL_PX, SIZE_PX) for index in range(VIEWS)]
    points = rng.uniform(-0.5, 0.5, (200, 3)) * (73.0, 28.0, 85.0)
    view = (rng.integers(0, VIEWS, len(points))[:, None] + np.arange(4)).ravel() % VIEWS
    point = np.repeat(np.arange(len(points)), 4)
    kept = (view != FEW) | (rng.random(len(view)) < 0.15)
    view, point = view[kept], point[kept]
    pixels = np.array([cameras[i].project(points[j][None])[0][0] for i, j in zip(view, point, strict=True)])
    return cameras, points, Tracks(view, point, pixels), np.where(view == NOISY, 0.9, 0.3)


def observe(scene, seed):
    """The cameras and points as they are after an adjustment to observations with errors, as a COLMAP model."""
    cameras, points, tracks, noise_px = scene
    pixels = tracks.pixels + np.random.default_rng(seed).normal(size=tracks.pixels.shape) * noise_px[:, None]
    model = pycolmap.Reconstruction()
    (width, height), middle = SIZE_PX, np.array(SIZE_PX) / 2
    lens = pycolmap.Camera(model="SIMPLE_PINHOLE", width=width, height=height, params=[FOCAL_PX, *middle], camera_id=1)
    model.add_camera_with_trivial_rig(lens)
    places = {}
    for index, camera in enumerate(cameras):
        own = np.flatnonzero(tracks.view == index)
        places |= {number: (index + 1, place) for place, number in enumerate(own)}
        image = pycolmap.Image(name=camera.name, keypoints=pixels[own], camera_id=1, image_id=index + 1)
        model.add_image_with_trivial_frame(image, to_rigid(camera.camera_from_world))
    for index, point in enumerate(points):
        track = pycolmap.Track()
        own = [places[number] for number in np.flatnonzero(tracks.point == index)]
        for element in own:
            track.add_element(*element)
        model.add_point3D_with_id(index + 1, pycolmap.Point3D(xyz=point, track=track))
        for image_id, place in own:
            model.images[image_id].set_point3D_for_point2D(place, index + 1)
    adjust_robustly(model, 1.0, 50)
    return model


def read_cameras(model, cameras):
    """The cameras of a model."""
    intrinsics = np.array(model.cameras[1].calibration_matrix())
    return [
        replace(camera, camera_from_world=to_matrix(model.images[index + 1].cam_from_world()), intrinsics=intrinsics)
        for index, camera in enumerate(cameras)
    ]


def deviations_of(model, cameras):
    adjusted = read_cameras(model, cameras)
    ids, tracks = read_tracks(model, adjusted)
    points = np.array([model.points3D[point_id].xyz for point_id in ids])
    return estimate_deviations(adjusted, tracks, points, np.zeros(3), RADIUS_MM)


def test_cameras_deviate_as_predicted(scene):
    """Over repeated observations: each camera within a factor of 1.8, all together within 1.3."""
    cameras = scene[0]
    models = [observe(scene, seed) for seed in range(12)]
    predicted = np.mean([deviations_of(model, cameras).object_px for model in models], axis=0)
    sphere = ObjectSphere(np.zeros(3), RADIUS_MM)
    errors_px = [measure_object_errors_px(list(zip(cameras, read_cameras(model, cameras), strict=True)), sphere) for model in models]
    found = np.sqrt(np.mean(np.square(errors_px), axis=0))
    np.testing.assert_array_less(np.abs(np.log(predicted / found)), np.log(1.8))
    assert abs(np.log(predicted / found).mean()) < np.log(1.3)


def test_the_camera_with_few_and_that_with_noisy_observations_deviate_most(scene):
    deviations = deviations_of(observe(scene, 0), scene[0])
    for values in (deviations.object_px, deviations.rotation_deg):
        assert values[FEW] > 1.5 * np.median(values)
    assert deviations.centre_share.argmax() == FEW  # what all share of it is the focal length's
    assert set(np.argsort(deviations.object_px)[-2:]) == {FEW, NOISY}


def test_the_world_in_which_cameras_are_given_does_not_matter(scene):
    cameras, points, tracks, noise_px = scene
    noisy = replace(tracks, pixels=tracks.pixels + np.random.default_rng(0).normal(size=tracks.pixels.shape) * noise_px[:, None])
    other = move_similarity(np.eye(4), np.array([0.3, -0.5, 1.1, 0.7, 2.0, -3.0, 1.0]), np.zeros(3), RADIUS_MM)
    moved = [transform_camera(camera, other) for camera in cameras]
    here = estimate_deviations(cameras, noisy, points, np.zeros(3), RADIUS_MM)
    there = estimate_deviations(moved, noisy, transform_points(points, other), other[:3, 3], RADIUS_MM * np.exp(0.7))
    for name in ("object_px", "rotation_deg", "centre_share"):
        np.testing.assert_allclose(getattr(here, name), getattr(there, name), rtol=1e-3)


def test_a_camera_that_nothing_holds_has_a_large_but_finite_deviation(scene):
    cameras, points, tracks, _ = scene
    held = tracks.view != FEW
    rest = Tracks(tracks.view[held], tracks.point[held], tracks.pixels[held])
    deviations = estimate_deviations(cameras, rest, points, np.zeros(3), RADIUS_MM)
    others = np.delete(deviations.object_px, FEW)
    assert np.isfinite(deviations.object_px).all() and deviations.object_px[FEW] > 20 > others.max()


def test_the_file_beside_the_cameras_is_read_again(scene, tmp_path):
    """It has a row for each image, and says of points behind a camera nothing."""
    model = observe(scene, 0)
    model.points3D[1].xyz = model.images[1].projection_center() * 2
    write_reconstruction(model, tmp_path / "sparse")
    write_deviations(tmp_path, by_outlines=False)
    assert (tmp_path / DEVIATIONS).read_text().splitlines()[0] == "image,deviation_px,rotation_deg,centre_share"
    stated = measure_deviations(read_views(tmp_path)[0], tmp_path / "sparse", by_outlines=False)
    assert list(read_deviations(tmp_path).values()) == pytest.approx(list(stated.object_px), abs=1e-4)
    assert read_deviations(tmp_path / "sparse") == {}
    assert stated.object_px.max() < 2.0


def test_outlines_hold_groups_that_share_no_points(scene):
    """Two halves of the ring, each with points of its own: nothing but the outlines of a box tells how they lie to each other."""
    cameras, points, tracks, _ = scene
    half = VIEWS // 2
    own = (tracks.point % 2) == (tracks.view // half)
    apart = Tracks(tracks.view[own], tracks.point[own], tracks.pixels[own])
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * (73.0, 28.0, 85.0)
    masks = {}
    for camera in cameras:
        outline = cv2.convexHull(np.rint(camera.project(corners)[0]).astype(np.int32))
        masks[camera.name] = cv2.fillConvexPoly(np.zeros(SIZE_PX[::-1], np.uint8), outline, 1) > 0
    adjustment = SilhouetteAdjustment(cameras, masks, NO_TRACKS)
    given = cameras, apart, points, adjustment.centre, adjustment.radius
    alone, held = (estimate_deviations(*given, told).object_px.mean() for told in (None, adjustment.measure_information()))
    assert held < 1.5 < 5.0 < alone


@pytest.mark.parametrize("estimated", [True, False])
def test_a_registration_states_them_unless_its_cameras_are_true(scene, tmp_path, estimated):
    model, out = observe(scene, 0), tmp_path / "cameras"
    write_registration(out, lambda folder: write_reconstruction(model, folder / "sparse") or {}, estimated)
    record = read_json(out / "registration.json")
    assert (out / DEVIATIONS).is_file() == ("deviation_px" in record) == estimated
    if estimated:
        stated = np.array(list(read_deviations(out).values()))
        assert record["deviation_px"] == pytest.approx({"median": np.median(stated), "largest": stated.max()}, abs=2e-3)


def test_unknowns_that_rounding_makes_looser_than_nothing_keep_finite_deviations():
    """Of photos from one side, the rounded information matrix has negative eigenvalues, and its inverse negative variances."""
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(5, 5)))[0]
    known = np.array([-1e3, 1.0, 1e4, 1e9, 1e13])
    root = _invert_root((turned * known) @ turned.T)
    variances = ((turned.T @ root) ** 2).sum(1)
    assert np.allclose(variances[:2], LOOSE**2, rtol=1e-2) and np.allclose(variances[2:], 1 / known[2:], rtol=1e-2)
