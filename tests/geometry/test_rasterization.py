"""The compiled rasterizer, its twin in PyTorch, and rays agree on what is where."""

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from helpers.drawn_boxes import HEIGHT_PX, INTRINSICS, WIDTH_PX, cast
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering import rasterization
from zeroshop_steps.geometry.rendering.rasterization import PixelGrid, draw_in_parts, rasterize

POSES = 5


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    """A small ball beside a box, which hides part of it from some sides."""
    ball = trimesh.creation.icosphere(3, 25.0).apply_translation([30, 0, 10])
    both = trimesh.util.concatenate([ball, trimesh.creation.box((40, 60, 30))])
    return Mesh(np.asarray(both.vertices), np.asarray(both.faces))


def posed(mesh: Mesh):
    """(P, 4, 4) camera_from_mesh, (P, V, 3) points in the camera, the faces and the grid of a camera's pixels."""
    poses = np.tile(np.eye(4), (POSES, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = Rotation.random(POSES, random_state=1).as_matrix(), [5.0, -4.0, 260.0]
    points = np.einsum("pij,vj->pvi", poses[:, :3, :3], mesh.vertices) + poses[:, None, :3, 3]
    focal, middle = np.diag(INTRINSICS)[:2], INTRINSICS[:2, 2]
    first, step = (torch.as_tensor(values, dtype=torch.float32).expand(POSES, 2) for values in ((0.5 - middle) / focal, 1 / focal))
    grid = PixelGrid(first, step, HEIGHT_PX, WIDTH_PX)
    return poses, torch.as_tensor(points, dtype=torch.float32), torch.as_tensor(mesh.faces), grid


def test_depth_is_that_of_rays(mesh):
    poses, points, faces, grid = posed(mesh)
    found = rasterize(points, faces, grid)
    depth = found.interpolate(points, faces)[..., 2].numpy()
    np.testing.assert_allclose(found.shares.sum(3), found.face >= 0, atol=1e-5)
    for pose, ours in zip(poses, depth, strict=True):
        _, _, rays = cast(mesh, Camera("", WIDTH_PX, HEIGHT_PX, INTRINSICS, pose))
        np.testing.assert_array_equal(ours > 0, rays > 0)
        np.testing.assert_allclose(ours, rays, atol=0.02)


@pytest.mark.parametrize("limit", [1, 1000, 1 << 20])
def test_the_compiled_kernel_draws_what_its_twin_draws_in_parts_of_any_size(mesh, monkeypatch, limit):
    monkeypatch.setattr(rasterization, "MOST_TRIANGLES", limit)
    _, points, faces, grid = posed(mesh)
    pixels = (points[..., :2] / points[..., 2:] - grid.first[:, None]) / grid.step[:, None]
    twin, kernel = draw_in_parts(pixels, points[..., 2], faces, grid), rasterize(points, faces, grid)
    torch.testing.assert_close(twin.face, kernel.face)
    torch.testing.assert_close(twin.shares, kernel.shares, rtol=0, atol=1e-5)


def test_what_is_behind_the_camera_or_beside_the_picture_is_not_drawn(mesh):
    _, points, faces, grid = posed(mesh)
    for moved in (points * torch.tensor([1.0, 1.0, -1.0]), points + torch.tensor([900.0, 0.0, 0.0])):
        found = rasterize(moved, faces, grid)
        assert (found.face == -1).all() and not found.shares.any()
        assert (found.interpolate(moved, faces) == 0).all()
