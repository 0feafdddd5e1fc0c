"""The rasterizer of many poses and rays agree on what is where. The kernel for CUDA is compared in test_mesh_rendering.py."""

import numpy as np
import pytest
import torch

from helpers import drawn_boxes
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.rasterization import rasterize

POSES = 5


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return drawn_boxes.make_boxes()


def test_depth_is_that_of_rays(mesh):
    cameras = drawn_boxes.make_cameras(count=POSES)
    points, faces, grid = drawn_boxes.pose(mesh, cameras)
    found = rasterize(points, faces, grid)
    depth = found.interpolate(points, faces)[..., 2].numpy()
    np.testing.assert_allclose(found.shares.sum(3), found.face >= 0, atol=1e-5)
    for camera, ours in zip(cameras, depth, strict=True):
        _, _, rays = drawn_boxes.cast(mesh, camera)
        np.testing.assert_array_equal(ours > 0, rays > 0)
        np.testing.assert_allclose(ours, rays, atol=0.02)


def test_what_is_behind_the_camera_or_beside_the_picture_is_not_drawn(mesh):
    points, faces, grid = drawn_boxes.pose(mesh, drawn_boxes.make_cameras(count=POSES))
    for moved in (points * torch.tensor([1.0, 1.0, -1.0]), points + torch.tensor([900.0, 0.0, 0.0])):
        found = rasterize(moved, faces, grid)
        assert (found.face == -1).all() and not found.shares.any()
        assert (found.interpolate(moved, faces) == 0).all()
