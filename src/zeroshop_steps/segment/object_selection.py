"""Select the object among all objects on the ground: the one nearest to the point that all cameras look at."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.beyond_ground import grow_beyond_ground
from zeroshop_steps.segment.voxel_carving import VoxelGrid, count_votes, fill_down_to_ground, label_clusters

# Set by hand on the kitchen photos, the DTU skull and rendered films (docs/results.md).
COARSE_VOXELS = 72  # along each edge of the searched block
REACH_DISTANCES = 0.42  # half the side of the searched block, in distances of the cameras from the focus
ENLARGED_TIMES, ENLARGED_VOXELS = 2, 18  # a side that the object comes near is moved so often and so far
BELOW_VOXELS = 2  # of the block's lower face below the plane, which is not exact
SURE_ODDS = 0.4  # log odds from which on a view votes
EMPTY_SHARE = 0.12  # of the votes; a voxel that more views show empty is empty
FULL_SHARE, FULL_VIEWS = 0.5, 3  # a voxel needs this share of the votes, and at least this many, to be full
LEAST_VOXELS = 30  # of an object; smaller clusters are noise
RIVAL_SHARE = 0.3
"""Where the cameras look between clusters, one of at least this share of the chosen one's size is a rival, ..."""
RIVAL_NEAR = 1.6
"""... if its distance from the focus is at most this many times the chosen one's."""
LOOKED_AT_VOXELS = 1.5  # a cluster this close to the focus is what the cameras look at, and has no rivals
PART_GAP_VOXELS = 6
"""Clusters that are closer to each other, with the cameras looking between them, are parts of one object."""
OUTSIDE_SHARE = 0.1  # of a cluster's voxels; where more lie outside of the median photo, the photos cut it off
FINE_VOXELS = 96  # along the longest edge of the block around the selected object
MARGIN = 0.12  # of that block around the cluster, as a share of the cluster's size


class NothingFound(StepError):
    """The photos do not tell an object from the ground where the cameras look."""


@dataclass(frozen=True)
class ObjectSelection:
    """The selected object.

    Attributes:
        grid: a block of voxels around it, of `FINE_VOXELS` along its longest side.
        allowed: (X, Y, Z) bool: voxels that may be its own.
        cluster: (X, Y, Z) bool: voxels of the cluster itself.
        ground_voxel: height of the support plane above the block's foot, in voxels.
        other_points: world positions (P, 3) of the centres of the other clusters' voxels; `other_side` is the edge of these voxels.
        cluster_count: number of clusters.
    """

    grid: VoxelGrid
    allowed: np.ndarray
    cluster: np.ndarray
    ground_voxel: float
    other_points: np.ndarray
    other_side: float
    cluster_count: int

    def own_points(self, points: np.ndarray) -> np.ndarray:
        """Those of the (P, 3) world positions that lie in `allowed` voxels, at most `MARGIN` of the block away from the cluster."""
        index, inside = self.grid.locate(points)
        inside[inside] = self.allowed[tuple(index[inside].T)]
        return points[inside]

    def with_others_of(self, before: "ObjectSelection") -> "ObjectSelection":
        """The same with the other things of a selection that saw more of the scene, but for what is now part of the object."""
        index, inside = self.grid.locate(before.other_points)
        inside[inside] = self.cluster[tuple(index[inside].T)]
        return replace(self, other_points=before.other_points[~inside], other_side=before.other_side)


def select_object(
    support: SceneSupport,
    cameras: list[Camera],
    evidence: list[np.ndarray],
    risen: np.ndarray | None = None,
    images: list[np.ndarray] | None = None,
) -> ObjectSelection:
    """Carve a block above the plane by the evidence of all views, and select one of the remaining clusters.

    Args:
        support: the plane.
        cameras: of all views.
        evidence: (H, W) log odds of an object in every view.
        risen: (P, 3) sparse points above a plain ground, which belong to objects whatever their colours; None where the ground is printed.
            On a plain ground, clusters that nearly touch are one object: its parts that have the ground's colours are missing in between.
        images: (H, W, 3) float32 RGB, 0 to 255, of the cameras' sizes: their colours tell the object where it stands before no ground. None
            where that part does not matter.

    Raises:
        NothingFound: nothing stands there.
        StepError: two objects are equally near to the focus.
    """
    parts = _find_whole(partial(_find_parts, support, cameras, evidence, risen, images), cameras)
    return _cut_fine_grid(parts.grid, parts.own, parts.others, parts.count)


@dataclass(frozen=True)
class _Parts:
    """What stands in a block: (X, Y, Z) bool, the voxels of the object and of other things; and the number of clusters."""

    grid: VoxelGrid
    own: np.ndarray
    others: np.ndarray
    count: int

    @cached_property
    def index(self) -> np.ndarray:
        """(P, 3) voxels of the object."""
        return np.argwhere(self.own)

    def reached_sides(self, margin: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """(3,) bool each: whether the object comes within a margin of the block's lower and upper end along an axis, but for the ground."""
        at_low, at_high = self.index.min(0) <= margin, self.index.max(0) >= np.array(self.own.shape) - 1 - margin
        return at_low & [True, True, False], at_high


def _find_whole(find_parts: Callable[[np.ndarray, np.ndarray], _Parts], cameras: list[Camera]) -> _Parts:
    """Tell the object from other things in a block that is enlarged where the object, with the margin around it, reaches its sides."""
    low = np.array([-COARSE_VOXELS // 2, -COARSE_VOXELS // 2, -BELOW_VOXELS])
    high = low + COARSE_VOXELS
    parts = first = find_parts(low, high)
    for _ in range(ENLARGED_TIMES):
        at_low, at_high = parts.reached_sides(_find_margin(parts.index))
        if not (at_low | at_high).any():
            break
        low, high = low - ENLARGED_VOXELS * at_low, high + ENLARGED_VOXELS * at_high
        try:
            parts = find_parts(low, high)
        except StepError:
            return first
        # What ends outside of the photos is the room behind, which the object has run into; and so is what ends nowhere.
        if _is_cut_off(parts.grid.centres(parts.index), cameras):
            return first
    return first if np.any(parts.reached_sides()) else parts


def _find_parts(
    support: SceneSupport,
    cameras: list[Camera],
    evidence: list[np.ndarray],
    risen: np.ndarray | None,
    images: list[np.ndarray] | None,
    low: np.ndarray,
    high: np.ndarray,
) -> _Parts:
    """Carve the block between two corners, (3,) voxels from the foot of the focus, and tell the object from other things.

    Arguments and errors otherwise as of `select_object`.
    """
    side = 2 * REACH_DISTANCES * support.distance / COARSE_VOXELS
    axes = np.vstack([support.axes(), support.normal])
    grid = VoxelGrid(axes, support.foot + low * side @ axes, side, tuple((high - low).tolist()))
    index = np.argwhere(np.ones(grid.shape, bool))
    index = index[index[:, 2] >= BELOW_VOXELS]
    full, empty = count_votes(grid, index, cameras, evidence, SURE_ODDS)
    kept = (empty <= EMPTY_SHARE * (full + empty)) & (full >= FULL_VIEWS) & (full >= FULL_SHARE * (full + empty))
    occupied = np.zeros(grid.shape, bool)
    occupied[tuple(index[kept].T)] = True
    if risen is not None:
        index, inside = grid.locate(risen)
        held = np.zeros(grid.shape, bool)
        held[tuple(index[inside].T)] = True
        occupied |= ndimage.binary_dilation(held)
    labels, count = label_clusters(occupied)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    names = np.flatnonzero(sizes >= LEAST_VOXELS) + 1
    if not len(names):
        raise NothingFound(
            "nothing stands on the ground where the cameras look: put the object there, keep it in the middle of the picture, "
            "see that it differs in colour from the ground, and that it is not moved between the first picture and the last"
        )
    places = {name: np.argwhere(labels == name)[:, :2] + 0.5 + low[:2] for name in names.tolist()}
    # The nearest edge counts most, because a large object may stand off the middle; then the mean.
    away = {name: np.linalg.norm(p, axis=1).min() + 0.5 * np.linalg.norm(p.mean(0)) for name, p in places.items()}
    cut_off = _find_cut_off(grid, labels, names, cameras) if len(names) > 1 else set()
    chosen = _choose(names, away, sizes, cut_off)
    if chosen not in cut_off:
        places = {name: place for name, place in places.items() if name not in cut_off}
    parts = _join_near(chosen, places) if risen is not None else _join_parts(chosen, places, away, sizes)
    own = np.isin(labels, parts)
    others = (labels > 0) & ~own
    if images is not None:
        own = grow_beyond_ground(grid, own, others, BELOW_VOXELS, cameras, images, evidence, SURE_ODDS)
    return _Parts(grid, own, others & ~own, count)


def _find_cut_off(grid: VoxelGrid, labels: np.ndarray, names: np.ndarray, cameras: list[Camera]) -> set[int]:
    """The clusters of which a part lies outside of most photos: the room behind, or another thing at the photos' borders."""
    return {name for name in names.tolist() if _is_cut_off(grid.centres(np.argwhere(labels == name)), cameras)}


def _is_cut_off(points: np.ndarray, cameras: list[Camera]) -> bool:
    """Whether much of (P, 3) points lies outside of the median photo."""
    return bool(np.median([1 - camera.find_pixels(points)[3].mean() for camera in cameras]) > OUTSIDE_SHARE)


def _choose(names: np.ndarray, away: dict[int, float], sizes: np.ndarray, cut_off: set[int]) -> int:
    """The cluster nearest to the focus; where the photos cut it off, one that is about as near and large, and that they show whole."""
    nearest = min(names.tolist(), key=lambda name: (away[name], name))
    if nearest not in cut_off:
        return int(nearest)
    whole = [
        name
        for name in names.tolist()
        if name not in cut_off and away[name] < RIVAL_NEAR * away[nearest] and sizes[name - 1] > RIVAL_SHARE * sizes[nearest - 1]
    ]
    return int(min(whole, key=lambda name: (away[name], name), default=nearest))


def _join_parts(chosen: int, places: dict[int, np.ndarray], away: dict[int, float], sizes: np.ndarray) -> list[int]:
    """The chosen cluster and those that are parts of the same object, because the cameras look between them.

    Raises:
        StepError: the cameras look between objects that stand apart.
    """
    if np.linalg.norm(places[chosen], axis=1).min() < LOOKED_AT_VOXELS:
        return [chosen]
    near = [name for name in places if name != chosen and away[name] < RIVAL_NEAR * away[chosen]]
    tree = cKDTree(places[chosen])
    gaps = {name: float(tree.query(places[name])[0].min()) for name in near}
    rivals = [name for name in near if gaps[name] > PART_GAP_VOXELS and sizes[name - 1] > RIVAL_SHARE * sizes[chosen - 1]]
    if rivals:
        raise StepError(
            f"{1 + len(rivals)} objects stand equally near to the point that the cameras look at; take away all but one, "
            "or keep the one that is meant in the middle of the picture"
        )
    return [chosen, *(name for name in near if gaps[name] <= PART_GAP_VOXELS)]


def _join_near(chosen: int, places: dict[int, np.ndarray]) -> list[int]:
    """The chosen cluster, the clusters at most `PART_GAP_VOXELS` away from it, those as near to them, and so on."""
    parts, left = [chosen], set(places) - {chosen}
    for part in parts:
        tree = cKDTree(places[part])
        near = {name for name in left if tree.query(places[name])[0].min() <= PART_GAP_VOXELS}
        parts.extend(sorted(near))
        left -= near
    return parts


def _find_margin(index: np.ndarray) -> int:
    """The margin around (P, 3) voxels of an object, in voxels."""
    return max(2, int(np.ceil(MARGIN * (np.ptp(index, axis=0) + 1).max())))


def _cut_fine_grid(grid: VoxelGrid, own: np.ndarray, others: np.ndarray, count: int) -> ObjectSelection:
    index = np.argwhere(own)
    low, high = index.min(0), index.max(0) + 1
    margin = _find_margin(index)
    low, high = np.maximum(low - margin, 0), np.minimum(high + margin, grid.shape)
    side = grid.side * float((high - low).max()) / FINE_VOXELS
    ground = (BELOW_VOXELS - float(low[2])) * grid.side / side
    shape = tuple(np.ceil((high - low) * grid.side / side - 1e-6).astype(int).tolist())
    fine = VoxelGrid(grid.axes, grid.origin + low * grid.side @ grid.axes, side, shape)
    # The object reaches the ground, even where its foot was carved off.
    nearest = ndimage.distance_transform_edt(~fill_down_to_ground(own))
    rival = ndimage.distance_transform_edt(~others) if others.any() else np.full(grid.shape, np.inf)
    room = (nearest <= margin) & (nearest < rival)
    coarse = np.minimum(((np.argwhere(np.ones(shape, bool)) + 0.5) * side / grid.side).astype(int) + low, np.array(grid.shape) - 1)
    near, inside = (part[tuple(coarse.T)].reshape(shape) for part in (room, own))
    return ObjectSelection(fine, near, inside, ground, grid.centres(np.argwhere(others)), grid.side, count)
