"""Compare masks with each other through their visual hull, the space that they have in common (Laurentini 1994).

The cameras must be known; a support plane and sparse points are not needed. Masks that show something else than most are found
first and left out of the hull.
"""

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.ray_convergence import find_nearest_point
from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.segment.quality.mask_quality import MaskQuality, compare_sizes, compare_with_hull
from zeroshop_steps.segment.support_voxels import VoxelGrid, count_votes, render_silhouettes

ROOM = 1.5  # half the edge of the voxel grid, in radii of the object
ROUNDS = ((0.34, 48), (0.2, 48), (0.1, 72), (0.05, 72))
"""Rounds of carving: the share of the views that see a voxel whose masks it may miss, many while masks of other things are included, and
the number of voxels along the grid's edge."""
LEAST_OVERLAP, LEAST_COVER = 0.5, 0.75
"""A mask is left out of the next round if its overlap with the silhouette is below this share of the median mask's, because it shows
another thing; and from the second round on, if what it covers of the silhouette is below this share of the median, because it lacks a
part. What a mask has beside the object does no harm to what all have in common."""
PART_SHARE, PART_VIEWS = 0.7, 3
"""A thin part that some masks lack belongs to the hull where, of the views that see it beside the rest, this share shows it, and at least
so many. A view with the rest before or behind it says nothing of it."""
PART_MARGIN = 0.02  # around the rest, where its own outline wavers; share of the square root of the silhouette's area
JUDGED_WIDTH_PX = 480  # masks are compared at this width at most, which is as fine as the voxels


def render_common_hull(cameras: list[Camera], masks: list[np.ndarray]) -> list[np.ndarray]:
    """(H, W) bool silhouette, in every view, of the hull of the masks that agree; empty if none do.

    Args:
        cameras: of all views, of the masks' sizes.
        masks: (H, W) bool; empty where the object was not found.
    """
    chosen = [index for index, mask in enumerate(masks) if mask.any()]
    hulls = [np.zeros_like(mask) for mask in masks]
    for number, (misses, voxels) in enumerate(ROUNDS):
        if len(chosen) < 2:
            break
        grid, occupied = _carve_hull([cameras[index] for index in chosen], [masks[index] for index in chosen], misses, voxels)
        last = number == len(ROUNDS) - 1
        hulls = render_silhouettes(grid, occupied, cameras) if occupied.any() else [np.zeros_like(masks[0]) for _ in cameras]
        if last:
            judged = [(cameras[index], masks[index], hulls[index]) for index in chosen]
            whole = _add_parts(grid, occupied, judged)
            return render_silhouettes(grid, whole, cameras) if whole.any() else hulls
        overlaps = {index: compute_overlap(masks[index], hulls[index]) for index in chosen}
        chosen = _keep_usual(overlaps, LEAST_OVERLAP)
        if number > 0:
            chosen = _keep_usual({index: (masks[index] & hulls[index]).sum() / max(hulls[index].sum(), 1) for index in chosen}, LEAST_COVER)
    return hulls


def _keep_usual(shares: dict[int, float], least: float) -> list[int]:
    """The views whose share is at least `least` of the median one, and not 0."""
    limit = least * float(np.median(list(shares.values()))) if shares else 0.0
    return [index for index, share in shares.items() if share >= limit > 0]


def assess_masks(masks: list[np.ndarray], cameras: list[Camera] | None) -> tuple[list[np.ndarray], list[MaskQuality]]:
    """Silhouettes of the hull of (H, W) bool masks, each of its mask's size, and how well each mask agrees with its silhouette.

    Masks of different sizes are compared at the one size of the first, which stretches some, and their cameras alike. Without cameras
    there is no hull, and the silhouettes are empty.
    """
    height, full_width = masks[0].shape
    width = min(JUDGED_WIDTH_PX, full_width)
    size_px = (width, round(height * width / full_width))
    small = [_resize_mask(mask, size_px) for mask in masks]
    if cameras is None:
        return [np.zeros_like(mask) for mask in masks], compare_sizes(small)
    hulls = render_common_hull([camera.resized(*size_px) for camera in cameras], small)
    shapes = [mask.shape for mask in masks]
    return [_resize_mask(hull, shape[::-1]) for hull, shape in zip(hulls, shapes, strict=True)], compare_with_hull(small, hulls)


def _resize_mask(mask: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    interpolation = cv2.INTER_AREA if size_px[0] < mask.shape[1] else cv2.INTER_LINEAR
    return cv2.resize(mask.astype(np.float32), size_px, interpolation=interpolation) > 0.5


def find_corners(mask: np.ndarray) -> tuple[float, float, float, float] | None:
    """Left, top, right, bottom of an (H, W) bool mask; None where it is empty."""
    y, x = np.nonzero(mask)
    return (float(x.min()), float(y.min()), float(x.max() + 1), float(y.max() + 1)) if len(y) else None


def _carve_hull(cameras: list[Camera], masks: list[np.ndarray], misses: float, voxels: int) -> tuple[VoxelGrid, np.ndarray]:
    """A block of voxels around what the masks look at, and (N, N, N) bool: those in the masks of all views that see them.

    A share of `misses` of these masks may lack a voxel. Views that the object is cut off in do not see all of it.
    """
    centre, radius = _find_looked_at(cameras, masks)
    side = 2 * ROOM * radius / voxels
    grid = VoxelGrid(np.eye(3), centre - ROOM * radius, side, (voxels,) * 3)
    index = np.argwhere(np.ones(grid.shape, bool))
    evidence = [np.where(mask, 1.0, -1.0).astype(np.float32) for mask in masks]
    votes = count_votes(grid, index, cameras, evidence)
    occupied = np.zeros(grid.shape, bool)
    kept = (votes.missed <= misses * votes.seen) & (votes.shown >= min(3, len(masks)))
    occupied[tuple(index[kept].T)] = True
    return grid, occupied


def _add_parts(grid: VoxelGrid, occupied: np.ndarray, judged: list[tuple[Camera, np.ndarray, np.ndarray]]) -> np.ndarray:
    """The (N, N, N) bool voxels, and the parts next to them that most masks have: handles, tips, what has the background's colours.

    Args:
        grid, occupied: the voxels.
        judged: of each view the camera, the (H, W) bool mask and silhouette of the voxels.
    """
    beside = []
    for _, mask, silhouette in judged:
        radius = max(1.0, PART_MARGIN * float(np.sqrt(silhouette.sum())))
        near = cv2.distanceTransform((~silhouette).astype(np.uint8), cv2.DIST_L2, 3) <= radius
        beside.append(np.where(near, 0.0, np.where(mask, 1.0, -1.0)).astype(np.float32))
    index = np.argwhere(~occupied)
    votes = count_votes(grid, index, [camera for camera, _, _ in judged], beside)
    whole = occupied.copy()
    whole[tuple(index[(votes.shown >= PART_VIEWS) & (votes.shown >= PART_SHARE * (votes.shown + votes.missed))].T)] = True
    labels, _ = ndimage.label(ndimage.binary_dilation(whole), np.ones((3, 3, 3)))
    return whole & np.isin(labels, np.unique(labels[occupied]))


def _find_looked_at(cameras: list[Camera], masks: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """The point nearest to the rays through the middles of the masks, by least absolute distances; the object's radius around it."""
    centres = np.array([camera.centre_in_world for camera in cameras])
    boxes = np.array([find_corners(mask) for mask in masks])
    middles = (boxes[:, :2] + boxes[:, 2:]) / 2
    point = find_nearest_point(centres, np.array([camera.find_ray(*middle) for camera, middle in zip(cameras, middles, strict=True)]))
    distances = np.linalg.norm(point - centres, axis=1)
    focal_px = np.array([camera.intrinsics[0, 0] for camera in cameras])
    half_diagonals = np.hypot(boxes[:, 2] - boxes[:, 0], boxes[:, 3] - boxes[:, 1]) / 2
    return point, float(np.median(half_diagonals / focal_px * distances))
