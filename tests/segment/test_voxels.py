"""Voxels as the views see them."""

import cv2
import numpy as np

from helpers.ball_scene import RADIUS, ball_cameras, ball_mask
from helpers.camera_ring import ring_camera
from zeroshop_steps.segment.support_voxels import VoxelGrid, carve, count_votes, render_shares, render_silhouettes, splat_voxels


def test_silhouettes_of_something_tall_have_no_gaps():
    """From near above, the top of a tower is twice as near as its foot: its voxels are twice as far apart in the picture."""
    camera = ring_camera(0, 2, distance=2.3, elevations_deg=(80.0, 80.0), at=(0.0, 0.0, 0.5), focal_px=1200.0, size_px=(1400, 1400))
    occupied = np.ones((24, 24, 60), bool)
    side = 1.5 / 60
    grid = VoxelGrid(np.eye(3), np.array([-12 * side, -12 * side, 0.0]), side, occupied.shape)
    (silhouette,) = render_silhouettes(grid, occupied, [camera])
    outline = cv2.convexHull(np.argwhere(silhouette)[:, ::-1].astype(np.int32))  # that of a box is convex
    midst = cv2.erode(cv2.fillConvexPoly(np.zeros(silhouette.shape, np.uint8), outline, 1), np.ones((51, 51))) > 0
    assert midst.sum() > 400_000 and silhouette[midst].all()


def test_a_camera_among_the_voxels_sees_what_is_before_it():
    camera = ring_camera(0, 2, distance=0.5, elevations_deg=(0.0, 0.0), at=(0.0, 0.0, 0.0), focal_px=40.0, size_px=(40, 30))
    beside = camera.centre_in_world + [[-1e-9, 0.0, 0.0]]
    assert splat_voxels(beside, 0.1, camera).all()
    assert not splat_voxels(camera.centre_in_world + [[0.3, 0.0, 0.0]], 0.1, camera).any()


def test_a_hull_bears_a_view_that_misses_the_object():
    """Of twelve masks of a ball, one is empty: the strict hull would be, too."""
    cameras = ball_cameras()
    masks = [2 * ball_mask(camera).astype(np.float32) - 1 for camera in cameras]
    masks[3][:] = -1
    side = 2.0 / 40
    grid = VoxelGrid(np.eye(3), np.full(3, -1.0), side, (40, 40, 40))
    index = np.argwhere(np.ones(grid.shape, bool))
    occupied = carve(grid, index, count_votes(grid, index, cameras, masks))
    volume = occupied.sum() * side**3
    assert 1.0 < volume / (4 / 3 * np.pi * RADIUS**3) < 1.4
    assert grid.look_up(occupied, np.array([[0.0, 0.0, 0.0], [0.9, 0.9, 0.9], [5.0, 0.0, 0.0]])).tolist() == [True, False, False]


def test_shares_are_those_of_the_other_views():
    """A half of the masks lacks the ball's upper half, and one shows a thing of its own: the half is shown by half, the thing by none."""
    cameras, side = ball_cameras(), 2.0 / 40
    truths = [ball_mask(camera) for camera in cameras]
    masks = [2 * truth.astype(np.float32) - 1 for truth in truths]
    for mask, truth in zip(masks[::2], truths[::2], strict=True):
        mask[: int(np.argwhere(truth)[:, 0].mean())] = -1
    masks[1][:, :10] = 1
    grid = VoxelGrid(np.eye(3), np.full(3, -1.0), side, (40, 40, 40))
    index = np.argwhere(np.ones(grid.shape, bool))
    shares = render_shares(grid, index, count_votes(grid, index, cameras, masks), cameras)[1]
    rows = np.argwhere(truths[1])[:, 0]
    upper, lower = truths[1].copy(), truths[1].copy()
    upper[int(np.percentile(rows, 30)) :], lower[: int(np.percentile(rows, 70))] = False, False
    assert 0.25 <= np.median(shares[upper]) <= 0.5 and np.median(shares[lower]) > 0.9
    assert shares[:, :10].max() <= 0.25
