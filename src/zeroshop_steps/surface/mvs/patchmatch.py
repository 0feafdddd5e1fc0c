"""Multi-view stereo by PatchMatch: for each pixel of each view, the slanted patch of surface on which the views agree best.

Every pixel holds a plane (depth and normal). In checkerboard order, planes propagate to their neighbours and are refined at
random, and the better plane stays (Bleyer et al. 2011; Galliani et al. 2015; Xu and Tao 2019). The cost of a plane is a
bilaterally weighted normalized cross-correlation with the best of the neighbouring views (Schönberger et al. 2016). In the
geometric rounds it also counts how well the plane agrees with the depths that those views have found.
"""

import math
from typing import Protocol

import cv2
import numba
import numpy as np

from zeroshop_steps.geometry.cameras.object_crops import STRIDE_PX
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.runtime.compute.kernel_devices import choose_kernel_device
from zeroshop_steps.runtime.progress import ProgressReport
from zeroshop_steps.surface.mvs.cpu_patchmatch import CpuPatchMatch
from zeroshop_steps.surface.mvs.patch_cost import CX, CY, DARK, DETAIL_PX, FX, FY, NEIGHBOURS, unproject_ray
from zeroshop_steps.surface.rendering.training_views import TrainingView

BLUR_PX = 0.6
"""Standard deviation of a blur that makes the colours smooth enough to be interpolated."""
MASK_EROSION_PX = 5
"""Edge of the square by which masks are eroded. The outermost pixels mix with the background: their edge moves with the view, not with
the surface."""
GEOMETRIC_REACH = 0.1
"""Reach of the random refinement in the geometric rounds; in the photometric ones it is 1, 1/2, 1/4."""
SEARCH_RADIUS = 1.8
"""Depths are searched within this many half extents of the hull's cube around its centre: its corners lie at 1.73."""


def select_neighbours(cameras: list[Camera], count: int = NEIGHBOURS) -> np.ndarray:
    """(V, count) indices of the views whose directions, seen from the object, are nearest to each view's own."""
    directions = np.array([camera.centre_in_world for camera in cameras])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    order = np.argsort(-(directions @ directions.T), axis=1, kind="stable")
    return np.ascontiguousarray(order[:, 1 : count + 1])


class PatchMatch(Protocol):
    """Planes at all pixels of all views, and the steps that improve them.

    `initialize`, `recompute` and `refine` work on a range of views. The result is the same however the views are divided.
    """

    @property
    def views_at_once(self) -> int:
        """How many views are best given to each step."""

    def initialize(self, views: range, seed: int) -> None:
        """Start with the best of a few random planes at every pixel."""

    def remember(self) -> None:
        """Let the planes as they are now be the depths that the other views have found."""

    def recompute(self, views: range) -> None:
        """Compute the costs of the planes again, with the depths that the other views have found."""

    def refine(self, views: range, reach: float, parity: int, salt: int) -> None:
        """For one half of the checkerboard, take over better planes from the other half, then refine them at random within `reach`."""

    def read(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth (V, H, W), normal (V, H, W, 3) and cost (V, H, W) of the planes, float32."""


def make_patchmatch(device: str, scene: tuple[np.ndarray, ...], near: np.ndarray, far: np.ndarray) -> PatchMatch:
    """PatchMatch on one of cpu, cuda and auto, as `choose_kernel_device` chooses; raises what it raises.

    Args:
        scene: rows, neighbours, color, detail, masks and sizes of all views, as in `patch_cost.plane_cost`.
        near, far: (V, H, W) float32, first and last depth of each pixel of each view's grid; 0 where there is none.
    """
    if choose_kernel_device(device) == "cpu":
        return CpuPatchMatch(scene, near, far)
    from zeroshop_steps.surface.mvs.cuda_patchmatch import CudaPatchMatch

    return CudaPatchMatch(scene, near, far)


def estimate_depth_maps(
    views: list[TrainingView],
    occupied: np.ndarray,
    half_extent: float,
    seed: int,
    photometric_rounds: int = 3,
    geometric_rounds: int = 2,
    device: str = "cpu",
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Depths, normals and costs of every view, at the pixels of its `make_grid_view`.

    Args:
        views: training views in normalized coordinates.
        occupied: (R, R, R) bool visual hull within the cube of +-half_extent, inside which surface is searched.
        seed: of the random planes.
        photometric_rounds, geometric_rounds: rounds of propagation and refinement without and with the other views' depths.
        device: cpu, cuda or auto, as in `make_patchmatch`.

    Returns:
        For each view (H, W) float32 depth along the optical axis, 0 outside the mask; (H, W, 3) float32 unit normal in the
        camera's axes; (H, W) float32 cost, 0 the best, 2 the worst.
    """
    rows = np.array([view.camera.row for view in views])
    neighbours = select_neighbours([view.camera for view in views], min(NEIGHBOURS, len(views) - 1))
    sizes = np.array([[view.camera.height_px, view.camera.width_px] for view in views])
    height, width = sizes.max(axis=0)
    color, detail, masks = _stack_images(views, height, width)
    grid = (len(views), -(-height // STRIDE_PX), -(-width // STRIDE_PX))
    near, far = np.zeros(grid, np.float32), np.zeros(grid, np.float32)
    for i in range(len(views)):
        _find_depth_interval(rows[i], sizes[i], masks[i], occupied, half_extent, near[i], far[i])
    search = make_patchmatch(device, (rows, neighbours, color, detail, masks, sizes), near, far)
    groups = [range(i, min(i + search.views_at_once, len(views))) for i in range(0, len(views), search.views_at_once)]
    with ProgressReport("stereo", len(views) * (1 + geometric_rounds)) as report:
        for group in groups:
            search.initialize(group, seed)
            for number in range(photometric_rounds):
                for parity in (0, 1):
                    search.refine(group, 0.5**number, parity, _mix_seed(seed, number))
            report.advance(len(group))
        for number in range(geometric_rounds):
            search.remember()
            for group in groups:
                search.recompute(group)
                for parity in (0, 1):
                    search.refine(group, GEOMETRIC_REACH, parity, _mix_seed(seed, 100 + number))
                report.advance(len(group))
    crops = [(slice(0, -(-h // STRIDE_PX)), slice(0, -(-w // STRIDE_PX))) for h, w in sizes]
    depths, normals, costs = ([values[i][crop] for i, crop in enumerate(crops)] for values in search.read())
    return depths, normals, costs


def _stack_images(views: list[TrainingView], height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blurred colours (V, H, W, 3), local contrast (V, H, W) and eroded masks (V, H, W) of all views, in one corner of equal images."""
    color = np.zeros((len(views), height, width, 3), np.float32)
    masks = np.zeros((len(views), height, width), np.bool_)
    square = np.ones((MASK_EROSION_PX, MASK_EROSION_PX), np.uint8)
    for i, view in enumerate(views):
        h, w = view.camera.height_px, view.camera.width_px
        color[i, :h, :w] = cv2.GaussianBlur(np.ascontiguousarray(view.color.numpy().transpose(1, 2, 0)), (0, 0), BLUR_PX)
        masks[i, :h, :w] = cv2.erode((view.mask.numpy() > 0.5).astype(np.uint8), square) > 0
    detail = np.stack([_local_contrast(*image) for image in zip(color.mean(axis=3), masks, strict=True)])
    return color, detail, masks


def _local_contrast(luminance: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W) float32: by how much, as a share, a pixel's luminance exceeds the mean around it. Of the object alone, 0 outside its mask."""
    inside = mask.astype(np.float32)
    total, weight = (cv2.GaussianBlur(image, (0, 0), DETAIL_PX) for image in (luminance * inside, inside))
    mean = total / np.maximum(weight, 1e-6)
    return inside * (luminance - mean) / (mean + DARK)


def _mix_seed(seed: int, number: int) -> int:
    """A seed of its own for each round."""
    return (seed * 1000 + number) * 7919 % 2**31


@numba.njit(cache=True, parallel=True)
def _find_depth_interval(row, size, mask, occupied, half, near, far):
    """Find the first and last depth at which each pixel's ray is inside the hull, widened by a voxel; both 0 where it misses it."""
    resolution = occupied.shape[0]
    step = half / resolution
    cx, cy, cz = unproject_ray(row, 0.0, 0.0, 0.0)
    distance = math.sqrt(cx * cx + cy * cy + cz * cz)
    for y in numba.prange(-(-size[0] // STRIDE_PX)):
        for x in range(-(-size[1] // STRIDE_PX)):
            py, px = y * STRIDE_PX, x * STRIDE_PX
            if not mask[py, px]:
                continue
            wx, wy, wz = unproject_ray(row, (px + 0.5 - row[CX]) / row[FX], (py + 0.5 - row[CY]) / row[FY], 1.0)
            rx, ry, rz = wx - cx, wy - cy, wz - cz
            length = math.sqrt(rx * rx + ry * ry + rz * rz)
            z = max((distance - SEARCH_RADIUS * half) / length, 1e-3)
            end = (distance + SEARCH_RADIUS * half) / length
            found = False
            while z < end:
                i, j, k = (
                    int((cx + z * rx + half) / (2 * step)),
                    int((cy + z * ry + half) / (2 * step)),
                    int((cz + z * rz + half) / (2 * step)),
                )
                if 0 <= i < resolution and 0 <= j < resolution and 0 <= k < resolution and occupied[i, j, k]:
                    if not found:
                        near[y, x] = z - 2 * step
                    found = True
                    far[y, x] = z + 2 * step
                z += step / length
