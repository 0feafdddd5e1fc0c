"""Every object on the support, and which of them is meant."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import space_evenly
from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.geometry.support.scene_support import SceneSupport
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.ground_picture import MOST_VIEWS
from zeroshop_steps.segment.support_voxels import VoxelGrid, carve, count_votes, render_silhouettes

# Lengths are shares of the cameras' distance from the focus.
COARSE_VOXELS, REACH = 96, 0.6  # along each edge of the searched block, and half its side
BELOW_VOXELS = 2  # of the block's lower face below the plane, which is not exact
LEAST_VOXELS = 40  # of an object; smaller clusters are noise
VOTE_ODDS = 1.5  # log odds that count as a full vote
NEAR_VOXELS = 4  # of the listed middle of an object, by which another plane, or less exact cameras, may move it
BRIDGE_VOXELS = 1  # a bridge no wider than twice this does not join two objects
FINE_VOXELS = 96  # along the longest edge of the block around an object
MARGIN = 0.15  # of that block around the object, as a share of its size
LEAST_TOUCHING = 0.01  # of a hull's voxels at the end of its room; fewer are noise of its outline
FRAGMENT_COVERED = 0.5  # of an object that lies within the outline of another: in photos around two objects, less does
CENTRE_WEIGHT, CUT_OFF_WEIGHT = 3.0, 1.0
"""What it costs an object to lie off the photos' middle, by half their diagonal, and outside of them, beside the logarithm of its size."""


class NothingFound(StepError):
    """The photos do not show an object where the cameras look."""


class TwoObjects(NothingFound):
    """The photos do not tell which of two objects is meant."""


@dataclass(frozen=True)
class SceneObjects:
    """The objects of a scene.

    Attributes:
        grid: the block of voxels that was searched.
        labels: (X, Y, Z) int: 0 where nothing is, and the objects' numbers from 1, the likeliest to be meant first.
        ground_voxel: height of the support plane above the block's foot, in voxels; below 0 where there is none.
        ratings: of the objects, falling.
    """

    grid: VoxelGrid
    labels: np.ndarray
    ground_voxel: float
    ratings: tuple[float, ...]

    def measure_rival(self, number: int) -> float:
        """How likely another object is meant instead of this one: 1 where one is rated alike or better, 0 where there is none."""
        others = [rating for place, rating in enumerate(self.ratings, 1) if place != number]
        return min(math.exp(max(others) - self.ratings[number - 1]), 1.0) if others else 0.0

    def find_at(self, place: np.ndarray) -> int:
        """The number of the object at a world position, (3,). Raises NothingFound where there is none."""
        index = np.argwhere(self.labels > 0)
        away = np.linalg.norm(self.grid.centres(index) - place, axis=1)
        if away.min() > NEAR_VOXELS * self.grid.side:
            raise NothingFound("the object that is meant was not found again where the list of objects has it; list them anew")
        return int(self.labels[tuple(index[away.argmin()])])

    def mark(self, points: np.ndarray) -> np.ndarray:
        """(X, Y, Z) bool: the voxels that hold world positions, (P, 3)."""
        index, inside = self.grid.locate(points)
        marked = np.zeros(self.labels.shape, bool)
        marked[tuple(index[inside].T)] = True
        return marked

    @property
    def count(self) -> int:
        """The number of objects."""
        return int(self.labels.max())


@dataclass(frozen=True)
class Room:
    """Where an object may be, in voxels of the searched block.

    Attributes:
        own: (X, Y, Z) bool: the object as far as it is known.
        reach: (X, Y, Z) bool: the room is this with a margin around it.
    """

    own: np.ndarray
    reach: np.ndarray


@dataclass(frozen=True)
class ObjectBlock:
    """A fine block of voxels around one object.

    Attributes:
        grid: the block, of `FINE_VOXELS` along its longest side.
        allowed: (X, Y, Z) bool: voxels that may be its own.
        occupied: (X, Y, Z) bool: voxels of the object as far as it is known.
        reach: (X, Y, Z) bool: these, and those up to which it may reach.
        ground_voxel: height of the support plane above the block's foot, in voxels; below 0 where there is none.
        other_points: world positions (P, 3) of the centres of the other objects' voxels; `other_side` is the edge of these.
    """

    grid: VoxelGrid
    allowed: np.ndarray
    occupied: np.ndarray
    reach: np.ndarray
    ground_voxel: float
    other_points: np.ndarray
    other_side: float

    @cached_property
    def index(self) -> np.ndarray:
        """(P, 3) the voxels that may be its own."""
        return np.argwhere(self.allowed)


def find_objects(
    cameras: Sequence[Camera], support: SceneSupport | None, focus: np.ndarray, distance: float, odds: Sequence[np.ndarray]
) -> SceneObjects:
    """Carve a block around the focus by the log odds of all views, and tell the objects in it from each other.

    Args:
        cameras: of the views.
        support: the plane; None where there is none.
        focus, distance: (3,) the point that the cameras look at, and how far they are from it.
        odds: (h, w) log odds of an object in every view.

    Raises:
        NothingFound: nothing is there.
    """
    side = 2 * REACH * distance / COARSE_VOXELS
    if support is None:
        axes, foot, low = np.eye(3), focus, -COARSE_VOXELS / 2
    else:
        axes, foot, low = np.vstack([support.axes(), support.normal]), support.foot, -BELOW_VOXELS
    origin = foot + side * np.array([-COARSE_VOXELS / 2, -COARSE_VOXELS / 2, low]) @ axes
    grid = VoxelGrid(axes, origin, side, (COARSE_VOXELS,) * 3)
    index = np.argwhere(np.ones(grid.shape, bool))
    index = index[index[:, 2] >= (0 if support is None else BELOW_VOXELS)]
    chosen = space_evenly(len(odds), MOST_VIEWS)
    asked = [cameras[view] for view in chosen]
    occupied = carve(grid, index, count_votes(grid, index, asked, [odds[view] for view in chosen], VOTE_ODDS))
    labels, count = _label(occupied, support is not None)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    names = [name for name in range(1, count + 1) if sizes[name] >= LEAST_VOXELS]
    if not names:
        raise NothingFound(
            "no object was found where the cameras look: nothing there is told from what is around it in nearly all photos. Keep it in the"
            " middle of the photos, alone, on a ground of other colours, and do not move it between the first photo and the last; or, as"
            " for a part of something larger, draw masks and name their folder in objects.tsv"
        )
    ratings = {name: _rate(grid, labels == name, asked) for name in names}
    ranks = sorted(names, key=lambda name: -ratings[name])
    order = np.zeros(count + 1, int)
    order[ranks] = np.arange(1, len(ranks) + 1)
    ground_voxel = BELOW_VOXELS if support is not None else -1.0
    return SceneObjects(grid, order[labels], ground_voxel, tuple(ratings[name] for name in ranks))


def join_fragments(found: SceneObjects, cameras: Sequence[Camera]) -> SceneObjects | None:
    """The objects with those joined to the first that most photos show within its outline, closed over hollows; None if there are none.

    They may be parts of it: where a side has the ground's colours, what is left of it falls apart.
    """
    if found.count < 2:
        return None
    first, *others = (render_silhouettes(found.grid, found.labels == number, cameras) for number in range(1, found.count + 1))
    closed = [_close_over(shown) for shown in first]
    covered = [0.0, 0.0]
    for silhouettes in others:
        shares = [(shown & whole).sum() / shown.sum() for shown, whole in zip(silhouettes, closed, strict=True) if shown.any()]
        covered.append(float(np.median(shares)) if shares else 0.0)
    parts = [number for number, share in enumerate(covered) if share > FRAGMENT_COVERED]
    if not parts:
        return None
    left = [number for number in range(found.count + 1) if number not in parts]
    names = np.array([1 if number in parts else left.index(number) for number in range(found.count + 1)])
    return replace(found, labels=names[found.labels], ratings=tuple(found.ratings[number - 1] for number in left[1:]))


def find_whole(found: SceneObjects, cameras: Sequence[Camera], points: np.ndarray) -> tuple[int, float]:
    """Of the objects by other log odds, the one that has most of an object's (P, 3) points, and the overlap of both in the median view.

    Raises NothingFound where none has.
    """
    own = found.mark(points)
    shares = np.bincount(found.labels[own], minlength=2)
    if not shares[1:].any():
        raise NothingFound("nothing is where the object is")
    number = 1 + int(shares[1:].argmax())
    pairs = zip(*(render_silhouettes(found.grid, part, cameras) for part in (own, found.labels == number)), strict=True)
    return number, float(np.median([compute_overlap(one, other) for one, other in pairs]))


def _close_over(shown: np.ndarray) -> np.ndarray:
    """The convex hull of (H, W) bool."""
    points = cv2.findNonZero(shown.astype(np.uint8))
    filled = np.zeros(shown.shape, np.uint8)
    return np.asarray((filled if points is None else cv2.fillConvexPoly(filled, cv2.convexHull(points), 1)) > 0)


def cut_block(found: SceneObjects, number: int, room: Room) -> ObjectBlock:
    """The fine block around the object of this number, in its room."""
    others = (found.labels > 0) & (found.labels != number)
    index = np.argwhere(room.reach)
    margin = _find_margin(room.reach)
    low, high = np.maximum(index.min(0) - margin, 0), np.minimum(index.max(0) + 1 + margin, others.shape)
    side = found.grid.side * float((high - low).max()) / FINE_VOXELS
    shape = tuple(np.ceil((high - low) * found.grid.side / side - 1e-6).astype(int).tolist())
    fine = VoxelGrid(found.grid.axes, found.grid.origin + low * found.grid.side @ found.grid.axes, side, shape)
    near, nearest_own = (ndimage.distance_transform_edt(~_find_standing(found, part)) for part in (room.reach, room.own))
    rival = ndimage.distance_transform_edt(~others) if others.any() else np.full(others.shape, np.inf)
    free = (near <= margin) & (nearest_own < rival)
    coarse = np.minimum(((np.argwhere(np.ones(shape, bool)) + 0.5) * side / found.grid.side).astype(int) + low, np.array(others.shape) - 1)
    allowed, occupied, reach = (part[tuple(coarse.T)].reshape(shape) for part in (free, room.own, room.reach))
    ground = (found.ground_voxel - float(low[2])) * found.grid.side / side if found.ground_voxel >= 0 else -1.0
    return ObjectBlock(fine, allowed, occupied, reach, ground, found.grid.centres(np.argwhere(others)), found.grid.side)


def fit_room(found: SceneObjects, room: Room, grid: VoxelGrid, hull: np.ndarray) -> Room | None:
    """The room for what was solved in another one: longer by its size where it touches the end of that one, else just around it.

    A room ends at a margin around the object as it was found; but that may lack a part, such as one that some photos cut off.

    Args:
        found, room: the objects, and the present room.
        grid, hull: the block, and (X, Y, Z) bool: what was solved in it.

    Returns:
        None where the present room does.
    """
    own = found.mark(grid.centres(np.argwhere(hull)))
    near, nearest = ndimage.distance_transform_edt(~_find_standing(found, room.reach), return_indices=True)
    ends = np.argwhere(own & (near > _find_margin(room.reach) - 1))
    ways = ends - nearest[:, *ends.T].T
    axes = np.abs(ways).argmax(1)
    signs = np.sign(np.take_along_axis(ways, axes[:, None], 1)[:, 0])
    longest, longer = int(np.ptp(np.argwhere(own), axis=0).max()) + 1, own
    for axis, sign in itertools.product(range(own.ndim), (-1, 1)):
        if ((axes == axis) & (signs == sign)).sum() >= LEAST_TOUCHING * own.sum():
            longer = longer | _sweep(own, axis, sign, longest)
    return Room(own, longer) if longer is not own or room.reach is not room.own else None


def _find_margin(reach: np.ndarray) -> int:
    """How many voxels a room extends beyond (X, Y, Z) bool."""
    return max(2, int(np.ceil(MARGIN * (np.ptp(np.argwhere(reach), axis=0) + 1).max())))


def _find_standing(found: SceneObjects, own: np.ndarray) -> np.ndarray:
    """(X, Y, Z) bool voxels down to the ground, which an object reaches even where its foot looks like it."""
    return np.asarray(np.flip(np.maximum.accumulate(np.flip(own, 2), axis=2), 2)) if found.ground_voxel >= 0 else own


def _sweep(own: np.ndarray, axis: int, sign: int, count: int) -> np.ndarray:
    """The (X, Y, Z) bool voxels moved along an axis, up or down, by 0 to `count` voxels."""
    swept = own.copy()
    along = np.moveaxis(swept, axis, 0)[::sign]
    for _ in range(count):
        along[1:] |= along[:-1]
    return swept


def _label(occupied: np.ndarray, stands: bool) -> tuple[np.ndarray, int]:
    """Label objects: what stands on a ground belongs together with what is above it; a thin bridge joins nothing."""
    part = occupied.any(axis=2) if stands else occupied
    window = np.ones((2 * BRIDGE_VOXELS,) * part.ndim)
    labels, count = ndimage.label(ndimage.binary_opening(part, window), np.ones((3,) * part.ndim))
    if not count:
        return np.zeros(occupied.shape, int), 0
    distance, nearest = ndimage.distance_transform_edt(labels == 0, return_indices=True)
    spread = np.where(distance <= 2 * BRIDGE_VOXELS, labels[tuple(nearest)], 0)
    return np.where(occupied, spread[:, :, None] if stands else spread, 0), count


def _rate(grid: VoxelGrid, own: np.ndarray, cameras: Sequence[Camera]) -> float:
    """How likely this object, (X, Y, Z) bool, is the one that is meant: large, in the middle of the photos, and whole in them."""
    sizes, asides, outside = [], [], []
    points = grid.centres(np.argwhere(own))
    for camera, shown in zip(cameras, render_silhouettes(grid, own, cameras), strict=True):
        half_diagonal = np.hypot(*shown.shape) / 2
        rows, columns = np.nonzero(shown)
        middle = np.array([rows.mean(), columns.mean()]) if len(rows) else np.zeros(2)
        asides.append(np.linalg.norm(middle - np.array(shown.shape) / 2) / half_diagonal)
        sizes.append(np.sqrt(len(rows)) / half_diagonal)
        outside.append(1 - camera.find_pixels(points)[3].mean())
    return float(np.log(np.median(sizes) + 1e-3) - CENTRE_WEIGHT * np.median(asides) - CUT_OFF_WEIGHT * np.median(outside))
