"""Refine evidence to masks, in rounds: cut each image by colours and edges, then carve the views' common hull from the masks."""

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.thread_pool import map_in_threads
from zeroshop_steps.segment.color_model import ColorModel
from zeroshop_steps.segment.graph_cut import cut_image
from zeroshop_steps.segment.ground import build_ground_picture
from zeroshop_steps.segment.object_selection import NothingFound, ObjectSelection
from zeroshop_steps.segment.plain_ground import join_odds
from zeroshop_steps.segment.voxel_carving import count_votes, fill_down_to_ground, mark_points, render_silhouettes, splat_voxels

# Odds are natural logarithms; lengths in images are shares of the square root of the silhouette's area.
# All were set by hand on the kitchen photos, the DTU skull and rendered films (docs/results.md).
COLOR_MOST = 1.5  # log odds of a colour, at most: single colours are never certain
INSIDE_ODDS = (0.5, 0.7, 0.7)
"""Log odds for pixels inside the common hull's silhouette, in each round."""
OUTSIDE_ODDS = (0.0, -1.5, -2.5)
"""Log odds for pixels well outside of it, in each round; a margin around it has 0."""
DEEP = 0.08  # from the rim of the hull's silhouette on, a pixel is in its midst
DEEP_ODDS = 0.5  # log odds there, at least, of what the hull and the colour say together
FORBIDDEN_ODDS = -6.0  # of pixels that cannot be the object: no colour outweighs it
HULL_MARGIN = 0.01  # width of the margin around the silhouette
RING = 0.6  # width of the surroundings whose colours are learned
MISSES_SHARE = 0.1  # of the masks of views that see a voxel of the hull, which may lack it
FLAT_SHARE, FLAT_VOXELS = 0.06, 2.0
"""Columns no higher than this share of the hull's height, or than so many voxels, are print or shadows on the ground."""
CONTACT_SHARE = 0.1
"""Gaps between ground and hull of up to this share of its height are closed: the object touches the ground there."""
STANDING_SHARE = 0.1
"""An object stands on the ground if at least this share of its voxels is connected with the ground, and of its columns reaches it."""
FLOATING_GAP_VOXELS = 2
"""Parts farther than twice this from everything that stands on the ground are dropped."""
HOLE_ODDS = 0.5
"""Holes in a mask are filled if their mean log odds of the object, by colour, are above this."""
SEED_ODDS, SEED_PX = 4.0, 1
"""Log odds of pixels this close to a sparse point of the object: it lies inside the silhouette in all views."""
HIDDEN_MARGINS = (0.04, -0.1, -0.15)
"""Ground this close to the silhouette is not looked at, in each round: at first parts may cover it that the hull lacks. Later the hull has
the dark ground at the foot too much, which would stay hidden for ever: below the rim of the silhouette, the ground is looked at."""


@dataclass(frozen=True)
class RefinedMasks:
    """Masks and their common hull.

    Attributes:
        masks: for each view, (H, W) float32 in [0, 1], above 1/2 on the object.
        hulls: for each view, (H, W) bool: the silhouette of the voxels that the masks share.
        occupied: (X, Y, Z) bool: these voxels.
    """

    masks: list[np.ndarray]
    hulls: list[np.ndarray]
    occupied: np.ndarray


def refine_masks(
    support: SceneSupport,
    selection: ObjectSelection,
    cameras: list[Camera],
    images: list[np.ndarray],
    by_place: list[np.ndarray],
    by_table: list[np.ndarray],
    priors: list[np.ndarray],
    own_points: np.ndarray,
) -> RefinedMasks:
    """Alternate between cutting the images and carving the hull of the masks.

    Args:
        support: the plane.
        selection: what was chosen on it.
        cameras: of all views.
        images: (H, W, 3) float32 RGB, 0 to 255, of the cameras' sizes.
        by_place: (H, W) log odds of the object in every view by what all views see at each place of the ground.
        by_table: the same by the colour of a plain ground; 0 where it is not plain.
        priors: the same by what else is known; 0 where nothing is.
        own_points: (P, 3) sparse points of the object; none where it is not plain.
    """
    rooms = render_silhouettes(selection.grid, selection.allowed, cameras)
    others = [splat_voxels(selection.other_points, selection.other_side, camera) for camera in cameras]
    occupied = _extend_to_ground(_drop_floating(selection.cluster, selection.ground_voxel))
    # Where all views agree is ground, even under the hull: shadows. It may also be an object of one colour, so colours weigh as much.
    agreed = [np.where(table > 0, 0.0, np.minimum(odds, 0.0)) for table, odds in zip(by_table, by_place, strict=True)]
    seeds = [SEED_ODDS * mark_points(own_points, 2 * SEED_PX + 1, camera) for camera in cameras]
    clues = [_Clues(*parts) for parts in zip(images, agreed, by_table, priors, seeds, rooms, others, strict=True)]
    for inside, outside, hidden_margin in zip(INSIDE_ODDS, OUTSIDE_ODDS, HIDDEN_MARGINS, strict=True):
        hulls = render_silhouettes(selection.grid, occupied, cameras)
        columns, whole = fill_down_to_ground(occupied), _restore_lost_foot(occupied, selection.ground_voxel)
        standing = render_silhouettes(selection.grid, columns, cameras)
        hidden = [_grow(foot, hidden_margin) | other for foot, other in zip(standing, others, strict=True)]
        feet = hulls if whole is occupied else render_silhouettes(selection.grid, whole, cameras)
        ground = build_ground_picture(support, cameras, images, hidden)
        evidence = [join_odds(odds, table) for odds, table in zip(map_in_threads(ground.evidence, cameras, images), by_table, strict=True)]
        colors = _learn_colors(images, hulls, [odds + prior for odds, prior in zip(evidence, priors, strict=True)])
        cut = partial(_cut_view, colors=colors, by_hull=(inside, outside), printed=ground.printed)
        masks = map_in_threads(cut, clues, evidence, hulls, feet)
        occupied = _carve_common(selection, cameras, masks)
    return RefinedMasks(masks, render_silhouettes(selection.grid, occupied, cameras), occupied)


@dataclass(frozen=True)
class _Clues:
    """What is known of one view in all rounds.

    Attributes:
        image: (H, W, 3) float32 RGB, 0 to 255.
        agreed, table, prior, seed: (H, W) log odds of the object by where all views agree, by the colour of a plain ground, by what else is
            known, and by the object's points.
        room, other: (H, W) bool: where the object may be, and where another thing is.
    """

    image: np.ndarray
    agreed: np.ndarray
    table: np.ndarray
    prior: np.ndarray
    seed: np.ndarray
    room: np.ndarray
    other: np.ndarray


def _cut_view(
    clues: _Clues, odds: np.ndarray, hull: np.ndarray, foot: np.ndarray, colors: ColorModel, by_hull: tuple[float, float], printed: float
) -> np.ndarray:
    """The mask of one view, (H, W) float32.

    Args:
        odds: (H, W) log odds of the object by the ground.
        hull, foot: (H, W) bool silhouettes of the hull, and of the hull with a foot.
        colors: of the object and around it.
        by_hull: log odds inside the hull's silhouette and well outside of it.
        printed: how far the ground is printed, 0 to 1.
    """
    inside, outside = by_hull
    deep = _grow(hull, -DEEP)
    odds, prior = (_discount(part, clues.other & ~deep) for part in (odds, clues.prior))
    color = np.clip(colors.of(clues.image), -COLOR_MOST, COLOR_MOST)
    # A shadow that the first masks took along has taught the colours that it is the object.
    color = np.where(clues.table < 0, np.minimum(color, 0.0), color)
    total = np.where(odds == 0.0, clues.agreed, odds) + color + prior
    total += np.where(hull | (foot & (color > 0)), inside, np.where(_grow(hull, HULL_MARGIN), 0.0, outside))
    if printed:  # a colour alone is no sign of ground in the midst of what nearly all masks share
        total += printed * np.where(deep, np.maximum(DEEP_ODDS - inside - color, 0.0), 0.0)
    return _close_holes(_cut_within(clues.room, total + clues.seed, clues.image), color)


def _discount(odds: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(H, W) log odds without what speaks for the object where another thing stands behind its rim, (H, W) bool, or beside it.

    The other thing differs from the ground as well, and a salient-object network may take it along in most photos.
    """
    return np.where(other, np.minimum(odds, 0.0), odds)


def _restore_lost_foot(occupied: np.ndarray, ground_voxel: float) -> np.ndarray:
    """The (X, Y, Z) bool voxels and, where hardly any of them reaches the ground, also all below them.

    Where all views agree on the colour of a plain foot, it is carved away like ground. Pixels there with the object's colours are the
    foot.
    """
    columns = occupied.any(axis=2)
    if not columns.any() or _take_lowest_part(occupied, ground_voxel).any(axis=2).sum() >= STANDING_SHARE * columns.sum():
        return occupied
    return occupied | fill_down_to_ground(occupied) & (np.arange(occupied.shape[2]) >= ground_voxel)


def _take_lowest_part(values: np.ndarray, ground_voxel: float) -> np.ndarray:
    """The lowest part of (X, Y, Z) values: what is in it touches the ground."""
    top = np.flatnonzero(values.any(axis=(0, 1)))[-1]
    return values[:, :, : int(ground_voxel + CONTACT_SHARE * (top - ground_voxel)) + 1]


def _cut_within(room: np.ndarray, evidence: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Cut the part of an image in which the object may be; the rest is background."""
    y, x = np.nonzero(room)
    mask = np.zeros(room.shape, np.float32)
    if len(y):
        crop = (slice(max(y.min() - 2, 0), y.max() + 3), slice(max(x.min() - 2, 0), x.max() + 3))
        mask[crop] = cut_image(np.where(room[crop], evidence[crop], FORBIDDEN_ODDS), image[crop])
    return mask


def _close_holes(mask: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Fill the holes of a cut that have the object's colours.

    The floor of a plain bowl is cut out like ground, because all views agree on it and it lies close to the ground.

    Args:
        mask: (H, W) float32.
        color: (H, W) log odds of the object for the colours.
    """
    count, labels = cv2.connectedComponents((mask <= 0.5).astype(np.uint8), connectivity=4)
    open_ones = np.unique(np.concatenate([labels[[0, -1]].ravel(), labels[:, [0, -1]].ravel()]))
    likely = ndimage.mean(color, labels, np.arange(count)) > HOLE_ODDS
    likely[open_ones] = likely[0] = False
    return np.where(likely[labels], np.float32(1), mask)


def _carve_common(selection: ObjectSelection, cameras: list[Camera], masks: list[np.ndarray]) -> np.ndarray:
    """The allowed voxels that lie in nearly all masks of the views that see them."""
    index = np.argwhere(selection.allowed)
    full, empty = count_votes(selection.grid, index, cameras, [2 * mask - 1 for mask in masks], 0.0)
    occupied = np.zeros(selection.allowed.shape, bool)
    occupied[tuple(index[empty <= MISSES_SHARE * (full + empty)].T)] = True
    return _extend_to_ground(_drop_floating(_drop_flat_columns(occupied, selection.ground_voxel), selection.ground_voxel))


def _drop_flat_columns(occupied: np.ndarray, ground_voxel: float) -> np.ndarray:
    """Drop columns that hardly rise above the ground: print and shadows agree between views, too, but are flat."""
    layers = np.flatnonzero(occupied.any(axis=(0, 1)))
    if not len(layers):
        return occupied
    top = occupied.shape[2] - occupied[:, :, ::-1].argmax(axis=2)
    flat = max(FLAT_SHARE * (layers[-1] - ground_voxel), FLAT_VOXELS)
    return occupied & (top - ground_voxel > flat)[:, :, None]


def _drop_floating(occupied: np.ndarray, ground_voxel: float) -> np.ndarray:
    """Drop parts that float beside what stands on the ground: few views see them, or they show what lies behind them.

    Where nearly everything floats, it is the object, whose plain foot was carved away like ground.
    """
    labels, count = ndimage.label(ndimage.binary_dilation(occupied, iterations=FLOATING_GAP_VOXELS), np.ones((3, 3, 3)))
    if count < 2:
        return occupied
    labels = np.where(occupied, labels, 0)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    sizes[0] = 0
    low = _take_lowest_part(labels, ground_voxel)
    standing = np.unique(low[low > 0])
    kept = standing if sizes[standing].sum() >= STANDING_SHARE * sizes.sum() else [sizes.argmax()]
    return np.isin(labels, kept)


def _extend_to_ground(occupied: np.ndarray) -> np.ndarray:
    """Extend columns that end just above the ground down to it: views at a flat angle tell the foot least well."""
    height = np.flatnonzero(occupied.any(axis=(0, 1)))
    if not len(height):
        return occupied
    lowest = np.where(occupied.any(axis=2), occupied.argmax(axis=2), occupied.shape[2])
    short = (lowest <= CONTACT_SHARE * height[-1])[:, :, None]
    below = np.arange(occupied.shape[2]) < lowest[:, :, None]
    return occupied | (short & below)


def _learn_colors(images: list[np.ndarray], hulls: list[np.ndarray], evidence: list[np.ndarray]) -> ColorModel:
    """Learn colours inside the hull and around it, without pixels whose evidence says otherwise.

    Raises:
        NothingFound: nothing is left on one side.
    """
    inside, outside = [], []
    for image, hull, odds in zip(images, hulls, evidence, strict=True):
        within = (cv2.erode(hull.astype(np.uint8), np.ones((5, 5))) > 0) & (odds >= 0.0)
        around = _grow(hull, RING) & ~_grow(hull, HULL_MARGIN) & (odds <= 0.0)
        inside.append(image[within][::2])
        outside.append(image[around][::4])
    samples = np.concatenate(inside), np.concatenate(outside)
    if not len(samples[0]) or not len(samples[1]):
        missing = "object" if not len(samples[0]) else "background"
        raise NothingFound(
            f"the photos do not tell the object from what is around it: no place is surely {missing}; keep the whole object in the middle "
            "of the photos, on a ground of other colours, or draw masks and name their folder in objects.tsv"
        )
    return ColorModel(*samples)


def _grow(mask: np.ndarray, share: float) -> np.ndarray:
    """Grow a mask by a share of the square root of its area; a negative share shrinks it."""
    radius = max(1, round(abs(share) * float(np.sqrt(mask.sum()))))
    if share < 0:
        return cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3) > radius
    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3) <= radius
