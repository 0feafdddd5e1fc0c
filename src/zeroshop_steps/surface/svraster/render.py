"""The renderer as one differentiable PyTorch operation over the CPU kernels."""

from dataclasses import dataclass

import numba
import numpy as np
import torch

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.surface.svraster import project, rasterize, rasterize_backward, tiles
from zeroshop_steps.surface.svraster.octree import Octree
from zeroshop_steps.surface.training_views import TILE_PX, TrainingView

NEAR = 0.05
"""Depth before which nothing is drawn, in normalized units."""


@dataclass(frozen=True)
class RenderView:
    """What the kernels need to know of a camera.

    Attributes:
        camera: (16,) float64: rotation (9) and translation (3) of camera_from_world, then fx, fy, cx, cy in pixels.
        width_px, height_px: image size.
        tile_shape: rows and columns of tiles.
        items: the tiles to draw, one for each octant of their rays.
        near: depth before which nothing is drawn.
    """

    camera: np.ndarray
    width_px: int
    height_px: int
    tile_shape: tuple[int, int]
    items: tiles.Items
    near: float

    @staticmethod
    def of(camera: Camera, tile_active: np.ndarray | None = None, near: float = NEAR) -> "RenderView":
        """A view of a pinhole camera; all tiles are drawn when `tile_active` (tiles_y, tiles_x) is None."""
        if tile_active is None:
            tile_active = np.ones((-(-camera.height_px // TILE_PX), -(-camera.width_px // TILE_PX)), bool)
        items = tiles.Items.of(camera.row, tile_active)
        return RenderView(camera.row, camera.width_px, camera.height_px, tile_active.shape, items, near)

    @staticmethod
    def around_object(view: TrainingView) -> "RenderView":
        """A training view."""
        return RenderView.of(view.camera, view.tile_active)


PARTS = (slice(0, 3), 3, slice(4, 7), 7, 8, 9, 10)
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
        footprint: holds, after `backward`, each voxel's largest blending weight and priority.
    """

    color: torch.Tensor
    depth: torch.Tensor
    normal: torch.Tensor
    alpha: torch.Tensor
    median_depth: torch.Tensor
    color_square: torch.Tensor
    away: torch.Tensor
    footprint: "Footprint"


@dataclass
class Footprint:
    """By-products of the backward pass: (N,) largest blending weight, and (N,) sum over pixels of |alpha d loss / d alpha|."""

    weight: np.ndarray | None = None
    priority: np.ndarray | None = None


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(context, densities, sh, octree, degree, view, footprint):
        arrays = [tensor.detach().contiguous().numpy() for tensor in (densities, sh)]
        drawn = _drawn(*arrays, octree, degree, view)
        context.kept = (arrays, octree, degree, view, footprint, *drawn)
        context.set_materialize_grads(False)
        planes = torch.from_numpy(drawn[3][:, : view.height_px, : view.width_px])
        return tuple(planes[part] for part in PARTS)

    @staticmethod
    def backward(context, *gradients):
        (densities, sh), octree, degree, view, footprint, rows, _, lists, image, blocks = context.kept
        gradient = np.zeros((rasterize.GRAD_PLANES, *image.shape[1:]), np.float32)
        for part, by_part in zip(PARTS, gradients, strict=True):
            if by_part is not None:
                gradient[part][..., : view.height_px, : view.width_px] = by_part.numpy()
        workers = numba.get_num_threads()
        by_row, seen = np.empty((len(octree), project.GRADIENT_WIDTH), np.float32), np.empty(len(octree), np.bool_)
        rasterize_backward.blend_backward(
            rows, view.camera, view.items.tiles, view.items.octants, lists.items, lists.starts, lists.voxel_of, lists.slot_of,
            lists.slot_starts, view.tile_shape[1], workers, image, blocks, gradient, by_row, seen,
        )  # fmt: skip
        by_corner, by_sh = np.zeros((len(octree), 8), np.float32), np.zeros_like(sh)
        project.project_backward(octree.centres, degree, view.camera, workers, rows, seen, by_row, by_corner, by_sh)
        by_density = np.empty_like(densities)
        project.gather_corners(*octree.corner_uses, by_corner.ravel(), by_density)
        footprint.weight, footprint.priority = by_row[:, project.G_WEIGHT], by_row[:, project.G_PRIORITY]
        return torch.from_numpy(by_density), torch.from_numpy(by_sh), None, None, None, None


def _drawn(densities: np.ndarray, sh: np.ndarray, octree: Octree, degree: int, view: RenderView):
    """Voxel rows, boxes, item lists, the padded (12, H, W) image of a view, and the blocks that each list entry is seen in."""
    workers = numba.get_num_threads()
    rows, boxes = np.empty((len(octree), project.ROW_WIDTH), np.float32), np.empty((len(octree), 4), np.int32)
    project.project_forward(
        octree.centres, octree.sizes, octree.corners, densities, sh, degree,
        view.camera, view.width_px, view.height_px, view.near, workers, rows, boxes,
    )  # fmt: skip
    lists = tiles.list_items(view.items, octree.orders, boxes)
    tiles_y, tiles_x = view.tile_shape
    image = np.zeros((rasterize.OUT_PLANES, tiles_y * TILE_PX, tiles_x * TILE_PX), np.float32)
    blocks = np.empty(len(lists.voxel_of), np.uint16)
    rasterize.blend_forward(
        rows, boxes, view.camera, view.items.tiles, view.items.octants, lists.items, lists.starts, lists.voxel_of,
        lists.slot_of, tiles_x, workers, image, blocks,
    )  # fmt: skip
    return rows, boxes, lists, image, blocks


def render(octree: Octree, densities: torch.Tensor, sh: torch.Tensor, degree: int, view: RenderView) -> Rendering:
    """Render voxels, differentiably.

    Args:
        octree: N leaves with M corners.
        densities: (M,) values at the corners, before activation.
        sh: (N, K, 3) spherical-harmonics coefficients of each leaf; those above `degree` are unused.
        degree: 0 to 3, with (degree + 1)^2 at most K.
        view: camera and tiles.
    """
    footprint = Footprint()
    return Rendering(*_Blend.apply(densities, sh, octree, degree, view, footprint), footprint)
