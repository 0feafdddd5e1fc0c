"""The renderer as one differentiable PyTorch operation over the kernels."""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import torch

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.surface.svraster import project, rasterize, tiles
from zeroshop_steps.surface.svraster.blending import Blending, CpuBlending, Listed
from zeroshop_steps.surface.svraster.octree import Octree
from zeroshop_steps.surface.tiling import TILE_PX
from zeroshop_steps.surface.training_views import TrainingView

CPU_BLENDING = CpuBlending()
NEAR = 0.05
"""Depth before which nothing is drawn, in normalized units."""


@dataclass(frozen=True)
class RenderView:
    """What the kernels need to know of a camera.

    Attributes:
        camera: (16,) float64: rotation (9) and translation (3) of camera_from_world, then fx, fy, cx, cy in pixels.
        width_px, height_px: image size.
        tile_octants: the tiles to draw, one for each octant of their rays.
        near: depth before which nothing is drawn.
    """

    camera: np.ndarray
    width_px: int
    height_px: int
    tile_octants: tiles.TileOctants
    near: float

    @staticmethod
    def from_camera(camera: Camera, tile_active: np.ndarray | None = None, near: float = NEAR) -> "RenderView":
        """A view of a pinhole camera; all tiles are drawn when `tile_active` (tiles_y, tiles_x) is None."""
        if tile_active is None:
            tile_active = np.ones((-(-camera.height_px // TILE_PX), -(-camera.width_px // TILE_PX)), bool)
        tile_octants = tiles.TileOctants.from_camera(camera.row, tile_active)
        return RenderView(camera.row, camera.width_px, camera.height_px, tile_octants, near)

    @staticmethod
    def from_training_view(view: TrainingView) -> "RenderView":
        """A training view."""
        return RenderView.from_camera(view.camera, view.tile_active)


PARTS: tuple[int | slice, ...] = (slice(0, 3), 3, slice(4, 7), 7, 8, 9, 10)
"""Planes of the image that make up the parts of a `Rendering`, in its order."""


@dataclass(frozen=True)
class Rendering:
    """Images of height x width pixels; all but `median_depth` are sums over the blending weights, not divided by `alpha`.

    Attributes:
        color: (3, H, W) RGB.
        depth: (H, W) weighted depth.
        normal: (3, H, W) weighted normal in the camera frame.
        alpha: (H, W) accumulated opacity.
        median_depth: (H, W) depth at which half of the light is stopped; 0 where less is.
        color_square: (H, W) weighted squared length of the colour.
        away: (H, W) weighted cosine between ray and those normals that face away.
        statistics: holds, after `backward`, each voxel's largest blending weight and priority.
    """

    color: torch.Tensor
    depth: torch.Tensor
    normal: torch.Tensor
    alpha: torch.Tensor
    median_depth: torch.Tensor
    color_square: torch.Tensor
    away: torch.Tensor
    statistics: "VoxelStatistics"


class VoxelStatistics:
    """By-products of the backward pass, for pruning and subdivision; zeros before it.

    Attributes:
        weight: (N,) largest blending weight of each voxel.
        priority: (N,) sum over the pixels of |alpha d loss / d alpha|.
    """

    def __init__(self, count: int) -> None:
        self.weight, self.priority = np.zeros(count, np.float32), np.zeros(count, np.float32)


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any, densities: torch.Tensor, sh: torch.Tensor, octree: Octree, degree: int, view: RenderView, statistics: VoxelStatistics,
        blending: Blending,
    ) -> tuple[torch.Tensor, ...]:  # fmt: skip
        arrays = [tensor.detach().contiguous().numpy() for tensor in (densities, sh)]
        listed = _list_voxels(arrays[0], arrays[1], octree, degree, view)
        image, kept = blending.draw(listed)
        context.kept = (arrays, octree, degree, view, statistics, blending, listed, image, kept)
        context.set_materialize_grads(False)
        planes = torch.from_numpy(image[:, : view.height_px, : view.width_px])
        return tuple(planes[part] for part in PARTS)

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        (densities, sh), octree, degree, view, statistics, blending, listed, image, kept = context.kept
        gradient = np.zeros((rasterize.GRAD_PLANES, *image.shape[1:]), np.float32)
        for part, by_part in zip(PARTS, gradients, strict=True):
            if by_part is not None:
                gradient[part][..., : view.height_px, : view.width_px] = by_part.numpy()
        by_row, seen = blending.differentiate(listed, image, kept, gradient)
        by_corner, by_sh = np.zeros((len(octree), 8), np.float32), np.zeros_like(sh)
        workers = numba.get_num_threads()
        project.project_backward(octree.centres, degree, view.camera, workers, listed.rows, seen, by_row, by_corner, by_sh)
        by_density = np.empty_like(densities)
        project.gather_corners(*octree.corner_uses, by_corner.ravel(), by_density)
        statistics.weight, statistics.priority = by_row[:, project.G_WEIGHT], by_row[:, project.G_PRIORITY]
        return torch.from_numpy(by_density), torch.from_numpy(by_sh), None, None, None, None, None


def _list_voxels(densities: np.ndarray, sh: np.ndarray, octree: Octree, degree: int, view: RenderView) -> Listed:
    """Voxel rows, boxes and pair lists of a view."""
    rows, boxes = np.empty((len(octree), project.ROW_WIDTH), np.float32), np.empty((len(octree), 4), np.int32)
    project.project_forward(
        octree.centres, octree.sizes, octree.corners, densities, sh, degree,
        view.camera, view.width_px, view.height_px, view.near, numba.get_num_threads(), rows, boxes,
    )  # fmt: skip
    return Listed(rows, boxes, view.camera, view.tile_octants, tiles.list_voxels_by_tile(view.tile_octants, octree.orders, boxes))


def render(
    octree: Octree, densities: torch.Tensor, sh: torch.Tensor, degree: int, view: RenderView, blending: Blending = CPU_BLENDING
) -> Rendering:
    """Render voxels, differentiably.

    Args:
        octree: N leaves with M corners.
        densities: (M,) values at the corners, before activation.
        sh: (N, K, 3) spherical-harmonics coefficients of each leaf; those above `degree` are unused.
        degree: 0 to 3, with (degree + 1)^2 at most K.
        view: camera and tiles.
        blending: where voxels are blended.
    """
    statistics = VoxelStatistics(len(octree))
    parts = _Blend.apply(densities, sh, octree, degree, view, statistics, blending)
    color, depth, normal, alpha, median_depth, color_square, away = parts
    return Rendering(color, depth, normal, alpha, median_depth, color_square, away, statistics)
