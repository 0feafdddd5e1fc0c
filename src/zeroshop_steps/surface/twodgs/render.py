"""The renderer as one differentiable PyTorch operation over the kernels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.surface.tiling import TILE_PX
from zeroshop_steps.surface.training_views import TrainingView
from zeroshop_steps.surface.twodgs import project, rasterize, surface_depth, tiles
from zeroshop_steps.surface.twodgs.blending import Blending, CpuBlending

CPU_BLENDING = CpuBlending()


@dataclass(frozen=True)
class RenderView:
    """What the kernels need to know of a camera.

    Attributes:
        camera: (16,) float64: rotation (9) and translation (3) of camera_from_world, then fx, fy, cx, cy in pixels.
        width_px, height_px: image size.
        tile_active: (ceil(height / 16), ceil(width / 16)) bool, the tiles to draw.
        near: depth before which a surfel is not drawn.
        depth_map: (k1, k2), the distortion term's mapped depth is k1 - k2 / z.
    """

    camera: np.ndarray
    width_px: int
    height_px: int
    tile_active: np.ndarray
    near: float
    depth_map: tuple[float, float]

    @staticmethod
    def from_camera(camera: Camera, near: float, far: float, tile_active: np.ndarray | None = None) -> "RenderView":
        """A view of a pinhole camera; all tiles are active when `tile_active` is None.

        near, far: nearest drawn depth, and the depth of the scene's far end. The distortion term sees z mapped to
            far (z - near) / (z (far - near)) as in the paper, less that of the middle, which changes no difference of
            depths and keeps its sums of squares precise in single precision.
        """
        if tile_active is None:
            tile_active = np.ones((-(-camera.height_px // TILE_PX), -(-camera.width_px // TILE_PX)), bool)
        stretch = near * far / (far - near)
        middle = 2.0 * near * far / (near + far)
        return RenderView(camera.row, camera.width_px, camera.height_px, tile_active, near, (stretch / middle, stretch))

    @staticmethod
    def from_training_view(view: TrainingView) -> "RenderView":
        """A training view, near and far two units from the origin: the normalized object lies within one."""
        distance = float(np.linalg.norm(view.camera.camera_from_world[:3, 3]))
        return RenderView.from_camera(view.camera, max(distance - 2.0, 0.05), distance + 2.0, view.tile_active)


PARTS: tuple[int | slice, ...] = (slice(0, 3), 3, slice(4, 7), 7, 8, 9)
"""Planes of the image that make up the parts of a `Rendering`, in its order."""


@dataclass(frozen=True)
class Rendering:
    """Images of height x width pixels; `color`, `depth` and `normal` are sums over the blending weights, not divided by `alpha`.

    Attributes:
        color: (3, H, W) RGB.
        depth: (H, W) weighted depth.
        normal: (3, H, W) weighted normal in the camera frame, facing the camera.
        alpha: (H, W) accumulated opacity.
        median_depth: (H, W) depth at which half of the light is stopped; 0 where nothing is hit.
        distortion: (H, W) depth distortion (Huang et al. 2024, eq. 13, in mapped depth), where asked for.
        statistics: which surfels were drawn and, after `backward`, their screen-space gradients.
    """

    color: torch.Tensor
    depth: torch.Tensor
    normal: torch.Tensor
    alpha: torch.Tensor
    median_depth: torch.Tensor
    distortion: torch.Tensor
    statistics: "SurfelStatistics"


class SurfelStatistics:
    """By-products of a rendering, for densification.

    Attributes:
        visible: (N,) bool, the surfels that were drawn.
        centre_gradient: (N,) length of the gradient by a surfel's projected centre, in loss per pixel; zeros before `backward`.
    """

    def __init__(self, count: int) -> None:
        self.visible, self.centre_gradient = np.zeros(count, bool), np.zeros(count, np.float32)


class _Splat(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any, positions: torch.Tensor, log_scales: torch.Tensor, quaternions: torch.Tensor, opacity_logits: torch.Tensor,
        sh: torch.Tensor, degree: int, view: RenderView, distortion: bool, statistics: SurfelStatistics, blending: Blending,
    ) -> tuple[torch.Tensor, ...]:  # fmt: skip
        arrays = [tensor.detach().contiguous().numpy() for tensor in (positions, log_scales, quaternions, opacity_logits, sh)]
        splats, boxes, lists, image = _draw(arrays, degree, view, distortion, blending)
        statistics.visible[lists.splat_of] = True
        context.kept = (arrays, degree, view, distortion, statistics, blending, splats, boxes, lists, image)
        context.set_materialize_grads(False)
        planes = torch.from_numpy(image[:, : view.height_px, : view.width_px])
        return tuple(planes[part] for part in PARTS)

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        arrays, degree, view, distortion, statistics, blending, splats, boxes, lists, image = context.kept
        positions, log_scales, quaternions, opacity_logits, sh = arrays
        gradient = np.zeros((rasterize.GRAD_PLANES, *image.shape[1:]), np.float32)
        for part, by_part in zip(PARTS, gradients, strict=True):
            if by_part is not None:
                gradient[part][..., : view.height_px, : view.width_px] = by_part.numpy()
        distortion = distortion and gradients[-1] is not None
        workers = project.numba.get_num_threads()
        by_splat = blending.differentiate(splats, lists, distortion, np.array(view.depth_map, np.float32), image, gradient)
        outputs = [np.zeros_like(array) for array in (positions, log_scales, quaternions, opacity_logits, sh)]
        project.project_backward(
            positions, log_scales, quaternions, sh, degree, view.camera, workers, splats, boxes, by_splat, *outputs
        )  # fmt: skip
        statistics.centre_gradient = np.hypot(by_splat[:, project.CX], by_splat[:, project.CY])
        return *(torch.from_numpy(output) for output in outputs), None, None, None, None, None


def _draw(
    arrays: Sequence[np.ndarray], degree: int, view: RenderView, distortion: bool = False, blending: Blending = CPU_BLENDING
) -> tuple:
    """Splat rows, boxes, tile lists and the padded (12, H, W) image of a view."""
    count, workers = len(arrays[0]), project.numba.get_num_threads()
    splats, boxes = np.zeros((count, project.SPLAT_WIDTH), np.float32), np.empty((count, 4), np.int32)
    outlines = np.empty((count, project.OUTLINE_WIDTH), np.float32)
    project.project_forward(
        *arrays, degree, view.camera, view.width_px, view.height_px, view.near, workers, splats, outlines, boxes
    )  # fmt: skip
    lists = tiles.list_splats_by_tile(splats, outlines, boxes, view.tile_active, workers)
    image = blending.draw(splats, lists, view.tile_active.shape, distortion, np.array(view.depth_map, np.float32))
    return splats, boxes, lists, image


def render_surface_depth(
    positions: torch.Tensor,
    log_scales: torch.Tensor,
    quaternions: torch.Tensor,
    opacity_logits: torch.Tensor,
    view: RenderView,
    reach: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the surface, (H, W) float32, 0 where nothing is hit, and the accumulated opacity, (H, W); not differentiable.

    Args:
        reach: surfels within this of a pixel's median depth are averaged.
        The other arguments are those of `render`.
    """
    tensors = (positions, log_scales, quaternions, opacity_logits, torch.zeros(len(positions), 16, 3))
    splats, _, lists, image = _draw([tensor.detach().contiguous().numpy() for tensor in tensors], 0, view)
    depth, median = np.zeros(image.shape[1:], np.float32), image[rasterize.OUT_MEDIAN]
    tiles_x = view.tile_active.shape[1]
    surface_depth.mean_near_median(
        splats, lists.tiles, lists.starts, lists.splat_of, lists.slot_of, lists.blocks, tiles_x, project.numba.get_num_threads(),
        median, np.float32(reach), depth,
    )  # fmt: skip
    crop = (slice(view.height_px), slice(view.width_px))
    return depth[crop], image[rasterize.OUT_ALPHA][crop]


def render(
    positions: torch.Tensor, log_scales: torch.Tensor, quaternions: torch.Tensor, opacity_logits: torch.Tensor, sh: torch.Tensor,
    degree: int, view: RenderView, distortion: bool = False, blending: Blending = CPU_BLENDING,
) -> Rendering:  # fmt: skip
    """Render surfels, differentiably.

    Args:
        positions: (N, 3) centres in the world.
        log_scales: (N, 2) natural logarithm of the two standard deviations.
        quaternions: (N, 4) rotation, w first, of any length; its columns are t_u, t_v and the normal.
        opacity_logits: (N,).
        sh: (N, 16, 3) spherical-harmonics coefficients; those above `degree` are unused.
        degree: 0 to 3.
        view: camera and tiles.
        distortion: whether the loss needs the depth distortion, which is zero otherwise.
        blending: where splats are blended.
    """
    statistics = SurfelStatistics(len(positions))
    color, depth, normal, alpha, median_depth, depth_distortion = _Splat.apply(
        positions, log_scales, quaternions, opacity_logits, sh, degree, view, distortion, statistics, blending
    )
    return Rendering(color, depth, normal, alpha, median_depth, depth_distortion, statistics)
