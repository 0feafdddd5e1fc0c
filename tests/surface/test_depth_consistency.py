"""Which depths of stereo are believed."""

import numpy as np
import pytest
import torch

from helpers.cup import RIM, camera_above, depth_of_cup
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.mvs.depth_consistency import confirm_depths
from zeroshop_steps.surface.rendering.training_views import TrainingView

RAISED = 0.15


def view_of(camera: Camera, luminance: np.ndarray, mask: np.ndarray) -> TrainingView:
    color = torch.from_numpy(np.repeat(luminance[None].astype(np.float32), 3, axis=0))
    active = torch.ones(mask.shape, dtype=torch.bool)
    return TrainingView(camera, color, torch.from_numpy(mask.astype(np.float32)), active, np.ones((8, 8), bool))


def depth_of_plane(camera: Camera, height: float) -> np.ndarray:
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    k, pose = camera.intrinsics, camera.camera_from_world
    rays = np.stack([(x + 0.5 - k[0, 2]) / k[0, 0], (y + 0.5 - k[1, 2]) / k[1, 1], np.ones(x.shape)], -1) @ pose[:3, :3]
    return ((height - camera.centre_in_world[2]) / rays[..., 2]).astype(np.float32)


def heights(camera: Camera, depth: np.ndarray) -> np.ndarray:
    y, x = np.nonzero(depth)
    k, pose = camera.intrinsics, camera.camera_from_world
    rays = np.stack([(x + 0.5 - k[0, 2]) / k[0, 0], (y + 0.5 - k[1, 2]) / k[1, 1], np.ones(len(x))], -1)
    return ((rays * depth[y, x, None] - pose[:3, 3]) @ pose[:3, :3])[:, 2]


@pytest.mark.slow
def test_depths_that_views_across_look_through_are_dropped() -> None:
    cameras = [camera_above(azimuth) for azimuth in range(0, 360, 30)]
    truths = [depth_of_cup(camera) for camera in cameras]
    views = [view_of(camera, np.zeros(truth.shape), truth > 0) for camera, truth in zip(cameras, truths, strict=True)]
    depths = []
    for i, (camera, truth) in enumerate(zip(cameras, truths, strict=True)):
        raised = depth_of_plane(camera, RIM + RAISED)
        over_the_hollow = (truth > 0) & (np.hypot(*np.mgrid[-60:60, -60:60]) < 12)
        depths.append(np.where(over_the_hollow & (i < 4), raised, truth))  # four neighbours agree on what is not there
    found = confirm_depths(views, depths)
    assert max(heights(camera, depth).max() for camera, depth in zip(cameras, found, strict=True)) < RIM + 0.02
    kept, true = (sum((depth > 0).sum() for depth in maps) for maps in (found, truths))
    assert kept > 0.6 * true, "what is there stays"


@pytest.mark.slow
def test_a_depth_that_only_its_neighbours_find_stays_while_nobody_contradicts() -> None:
    cameras = [camera_above(azimuth) for azimuth in range(0, 360, 30)]
    truths = [depth_of_cup(camera) for camera in cameras]
    views = [view_of(camera, np.zeros(truth.shape), truth > 0) for camera, truth in zip(cameras, truths, strict=True)]
    few = [truth if i < 4 else np.zeros_like(truth) for i, truth in enumerate(truths)]
    found = confirm_depths(views, few)
    assert sum((depth > 0).sum() for depth in found) > 0.5 * sum((depth > 0).sum() for depth in few)
    alone = [truth if i == 0 else np.zeros_like(truth) for i, truth in enumerate(truths)]
    assert not any(depth.any() for depth in confirm_depths(views, alone)), "one view alone confirms nothing"
