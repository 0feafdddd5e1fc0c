"""Right cameras pass the checks, wrong ones do not, and nothing but the pictures is asked."""

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.ball_scene import ball_cameras, ball_mask
from helpers.camera_ring import ring_camera
from zeroshop_steps.register.silhouettes.coherence import (
    bound_object,
    find_doubtful_mask,
    find_wrong_masks,
    measure_misses_without,
    measure_silhouette_coherence,
)
from zeroshop_steps.register.verification.epipolar_support import EpipolarSupport, find_explained

SIZE_MM = (73.0, 28.0, 85.0)


@pytest.fixture(scope="module")
def views():
    """A ring of ten cameras around a box, and its silhouettes."""
    cameras = [ring_camera(index, 10, 300.0, (35.0, 35.0), (0.0, 0.0, 0.0), 630.0, (480, 360)) for index in range(10)]
    corners = np.array(list(itertools.product((-1, 1), repeat=3))) * SIZE_MM / 2
    masks = {}
    for camera in cameras:
        outline = cv2.convexHull(np.rint(camera.project(corners)[0] - 0.5).astype(np.int32))
        masks[camera.name] = cv2.fillConvexPoly(np.zeros((360, 480), np.uint8), outline, 1) > 0
    return cameras, masks


def orbited(camera, angle_deg: float):
    """The camera turned about the world's z axis, still looking at the object."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", angle_deg, degrees=True).as_matrix()
    return replace(camera, camera_from_world=camera.camera_from_world @ turn)


def test_true_cameras_explain_every_silhouette(views):
    assert measure_silhouette_coherence(*views).unexplained_px.max() <= 1.5


def test_a_misplaced_camera_is_found(views):
    cameras, masks = views
    wrong = [orbited(camera, 50.0) if index == 3 else camera for index, camera in enumerate(cameras)]
    coherence = measure_silhouette_coherence(wrong, masks)
    assert coherence.unexplained_px.max() > 6.0
    assert coherence.culprit() == cameras[3].name


def test_wrong_masks_are_found_and_right_ones_are_not(views):
    """A part is missing, something else is in it, all of it is elsewhere: each in another view."""
    cameras, masks = views
    names = [camera.name for camera in cameras]
    masks = dict(masks)
    half = masks[names[2]].copy()
    half[: int(np.nonzero(half)[0].mean())] = False
    more = masks[names[5]] | np.roll(masks[names[5]], 60, axis=1)
    masks |= {names[2]: half, names[5]: more, names[9]: np.roll(masks[names[9]], (50, -70), (0, 1))}
    limits_px = np.array([0.06 * np.sqrt(mask.sum()) for mask in masks.values()])
    assert find_wrong_masks(cameras, masks, limits_px) == [names[2], names[5], names[9]]
    assert find_wrong_masks(*views, limits_px) == []


def test_what_rays_miss_without_a_mask_is_what_they_miss_among_the_others():
    cameras = ball_cameras(6)
    masks = {camera.name: ball_mask(camera) for camera in cameras}
    masks[cameras[1].name] = np.roll(masks[cameras[1].name], 20, axis=1)
    unexplained_px, without_px = measure_silhouette_coherence(cameras, masks).unexplained_px, measure_misses_without(cameras, masks)
    others = [index for index in range(6) if index != 1]
    among = measure_silhouette_coherence([cameras[index] for index in others], masks)
    assert np.allclose(without_px[1, others], among.unexplained_px, atol=1.0)
    assert unexplained_px[others].max() > 5.0 and without_px[1, others].max() < 1.5
    assert find_doubtful_mask(cameras, masks) == cameras[1].name


def test_half_a_ring_on_the_wrong_side_is_found(views):
    cameras, masks = views
    wrong = [orbited(camera, 90.0) if index < 5 else camera for index, camera in enumerate(cameras)]
    assert measure_silhouette_coherence(wrong, masks).unexplained_px.max() > 6.0


def test_object_sphere_holds_the_object(views):
    cameras, masks = views
    centre, radius = bound_object(cameras, list(masks.values()))
    assert np.linalg.norm(centre) < 10.0  # the model's origin is its middle
    assert 40.0 < radius < 200.0


def test_matches_are_explained_by_the_true_pose_only():
    rng = np.random.default_rng(0)
    points = rng.uniform([-1, -1, 4], [1, 1, 6], (100, 3))
    second_from_first = np.column_stack([Rotation.from_euler("y", 20, degrees=True).as_matrix(), [-1.7, 0.1, 0.2]])
    moved = points @ second_from_first[:, :3].T + second_from_first[:, 3]
    first, second = points[:, :2] / points[:, 2:], moved[:, :2] / moved[:, 2:]
    assert find_explained(first, second, second_from_first, 1e-9).all()
    mirrored = second_from_first * [1, 1, 1, -1]
    assert not find_explained(first, second, mirrored, 1e-9).any()  # on the epipolar lines, but behind the cameras
    other = np.column_stack([Rotation.from_euler("y", 25, degrees=True).as_matrix(), [-1.7, 0.5, 0.2]])
    assert find_explained(first, second, other, 1e-3).mean() < 0.2


def test_weakest_cut_finds_the_loose_group():
    supporting = np.zeros((6, 6), int)
    for group in (range(4), range(4, 6)):
        for i in group:
            for j in group:
                supporting[i, j] = 100 * (i != j)
    supporting[1, 5] = supporting[5, 1] = 7
    evidence = EpipolarSupport(tuple("abcdef"), supporting, np.zeros_like(supporting))
    assert evidence.weakest_cut() == (7, ("e", "f"))
