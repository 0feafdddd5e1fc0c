"""From evidence to masks: colours and edges cut every image, the views' common hull keeps the cuts consistent, and again."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.segment.color_model import ColorModel
from zeroshop_steps.segment.graph_cut import cut_image
from zeroshop_steps.segment.ground import build_ground_picture
from zeroshop_steps.segment.object_selection import ObjectSelection
from zeroshop_steps.segment.voxel_carving import count_votes, fill_down_to_ground, render_silhouette, splat_voxels

COLOR_MOST = 1.5
INSIDE_ODDS = (0.5, 0.7, 0.7)
"""What lying in the common hull's silhouette speaks for the object, in each round."""
OUTSIDE_ODDS = (0.0, -1.5, -2.5)
"""What lying well outside of it does; a margin around it is left open."""
FORBIDDEN_ODDS = -6.0
HULL_MARGIN = 0.03  # of the square root of the silhouette's area
RING = 0.6  # width of the surroundings whose colours count, in square roots of the silhouette's area
MISSES_SHARE = 0.1
FLAT_SHARE, FLAT_VOXELS = 0.06, 2.0
"""Columns no higher than this share of the hull's height, or than these voxels, are no part of it."""
CONTACT_SHARE = 0.1
"""Gaps below the hull up to this share of its height are closed: there it touches the ground."""
STANDING_SHARE = 0.1
"""Of an object that stands on the ground, at least this share of its voxels hangs together with it, and of their columns reaches it."""
FLOATING_GAP_VOXELS = 2
"""Parts farther than twice this from all that stands on the ground are no part of it."""
HOLE_ODDS = 0.5
"""Holes in whose colours the object is likelier than this, in log odds, are none."""
HIDDEN_MARGIN = 0.04
"""Ground this near to the hull's silhouette, in square roots of its area, may be object that the hull lacks."""


@dataclass(frozen=True)
class RefinedMasks:
    """Masks and what they agree on.

    Attributes:
        masks: for each view, (H, W) float32 in [0, 1], above 1/2 on the object.
        hulls: for each view, (H, W) bool: the silhouette of the voxels that the masks share.
        occupied: (X, Y, Z) bool: these voxels.
    """

    masks: list[np.ndarray]
    hulls: list[np.ndarray]
    occupied: np.ndarray


def refine_masks(support: SceneSupport, selection: ObjectSelection, cameras: list[Camera], images: list[np.ndarray]) -> RefinedMasks:
    """Alternate between cutting the images and carving the space they share.

    Args:
        images: (H, W, 3) float32 RGB, 0 to 255, of the cameras' sizes.
    """
    rooms = [render_silhouette(selection.grid, selection.allowed, camera) for camera in cameras]
    others = [splat_voxels(selection.other_points, selection.other_side, camera) for camera in cameras]
    occupied = _extend_to_ground(_drop_floating(selection.cluster, selection.ground_voxel))
    # Where all views agree there is ground, even under the hull: shadows. Or an object of one colour, hence colours weigh as much.
    plain = build_ground_picture(support, cameras, images)
    agreed = [np.minimum(plain.evidence(camera, image), 0.0) for camera, image in zip(cameras, images, strict=True)]
    for inside, outside in zip(INSIDE_ODDS, OUTSIDE_ODDS, strict=True):
        hulls = [render_silhouette(selection.grid, occupied, camera) for camera in cameras]
        columns, whole = fill_down_to_ground(occupied), _restore_lost_foot(occupied, selection.ground_voxel)
        standing = [render_silhouette(selection.grid, columns, camera) for camera in cameras]
        hidden = [_grow(foot, HIDDEN_MARGIN) | other for foot, other in zip(standing, others, strict=True)]
        feet = hulls if whole is occupied else [render_silhouette(selection.grid, whole, camera) for camera in cameras]
        ground = build_ground_picture(support, cameras, images, hidden)
        evidence = [ground.evidence(camera, image) for camera, image in zip(cameras, images, strict=True)]
        colors = _learn_colors(images, hulls, evidence)
        masks = []
        for image, odds, agree, hull, foot, room in zip(images, evidence, agreed, hulls, feet, rooms, strict=True):
            color = np.clip(colors.of(image), -COLOR_MOST, COLOR_MOST)
            total = np.where(odds == 0.0, agree, odds) + color
            total += np.where(hull | (foot & (color > 0)), inside, np.where(_grow(hull, HULL_MARGIN), 0.0, outside))
            masks.append(_close_holes(_cut_within(room, total, image), color))
        occupied = _carve_common(selection, cameras, masks)
    return RefinedMasks(masks, [render_silhouette(selection.grid, occupied, camera) for camera in cameras], occupied)


def _restore_lost_foot(occupied: np.ndarray, ground_voxel: float) -> np.ndarray:
    """The (X, Y, Z) bool voxels and, where hardly any of them reaches the ground, all between them and it.

    Where all views agree on the colour of a plain foot, carving takes it for ground. What has the object's colours there is that foot.
    """
    columns = occupied.any(axis=2)
    if not columns.any() or _take_lowest_part(occupied, ground_voxel).any(axis=2).sum() >= STANDING_SHARE * columns.sum():
        return occupied
    return occupied | fill_down_to_ground(occupied) & (np.arange(occupied.shape[2]) >= ground_voxel)


def _take_lowest_part(values: np.ndarray, ground_voxel: float) -> np.ndarray:
    """The part of (X, Y, Z) values up to a share of the height at which what is there stands on the ground."""
    top = np.flatnonzero(values.any(axis=(0, 1)))[-1]
    return values[:, :, : int(ground_voxel + CONTACT_SHARE * (top - ground_voxel)) + 1]


def _cut_within(room: np.ndarray, evidence: np.ndarray, image: np.ndarray) -> np.ndarray:
    """The cut of the room's part of an image; nothing is the object outside."""
    y, x = np.nonzero(room)
    mask = np.zeros(room.shape, np.float32)
    if len(y):
        crop = (slice(max(y.min() - 2, 0), y.max() + 3), slice(max(x.min() - 2, 0), x.max() + 3))
        mask[crop] = cut_image(np.where(room[crop], evidence[crop], FORBIDDEN_ODDS), image[crop])
    return mask


def _close_holes(mask: np.ndarray, color: np.ndarray) -> np.ndarray:
    """The cut with its holes filled in which one sees the object's colours.

    All views agree on the floor of a plain bowl as they do on ground: it lies where the ground does.

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
    """Voxels of the subject's room that lie within nearly all masks."""
    index = np.argwhere(selection.allowed)
    _, empty = count_votes(selection.grid, index, cameras, [2 * mask - 1 for mask in masks], 0.0)
    occupied = np.zeros(selection.allowed.shape, bool)
    occupied[tuple(index[empty <= MISSES_SHARE * len(cameras)].T)] = True
    return _extend_to_ground(_drop_floating(_drop_flat_columns(occupied, selection.ground_voxel), selection.ground_voxel))


def _drop_flat_columns(occupied: np.ndarray, ground_voxel: float) -> np.ndarray:
    """Without the columns that hardly rise above the ground: all views agree on prints and shadows, too, but those are flat."""
    layers = np.flatnonzero(occupied.any(axis=(0, 1)))
    if not len(layers):
        return occupied
    top = occupied.shape[2] - occupied[:, :, ::-1].argmax(axis=2)
    flat = max(FLAT_SHARE * (layers[-1] - ground_voxel), FLAT_VOXELS)
    return occupied & (top - ground_voxel > flat)[:, :, None]


def _drop_floating(occupied: np.ndarray, ground_voxel: float) -> np.ndarray:
    """Without what hangs in the air beside what stands: space that few views see, or that shows what lies behind it.

    Where nearly all of it hangs, that is the object, and its foot is what lacks: all views agree on the colour of a plain one there.
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
    """Columns that end just above the ground reach down to it: the object stands, and its foot is what grazing views tell worst."""
    height = np.flatnonzero(occupied.any(axis=(0, 1)))
    if not len(height):
        return occupied
    lowest = np.where(occupied.any(axis=2), occupied.argmax(axis=2), occupied.shape[2])
    short = (lowest <= CONTACT_SHARE * height[-1])[:, :, None]
    below = np.arange(occupied.shape[2]) < lowest[:, :, None]
    return occupied | (short & below)


def _learn_colors(images: list[np.ndarray], hulls: list[np.ndarray], evidence: list[np.ndarray]) -> ColorModel:
    """Learned inside the hull and around it, but for what speaks against it."""
    inside, outside = [], []
    for image, hull, odds in zip(images, hulls, evidence, strict=True):
        within = (cv2.erode(hull.astype(np.uint8), np.ones((5, 5))) > 0) & (odds >= 0.0)
        around = _grow(hull, RING) & ~_grow(hull, HULL_MARGIN) & (odds <= 0.0)
        inside.append(image[within][::2])
        outside.append(image[around][::4])
    return ColorModel(np.concatenate(inside), np.concatenate(outside))


def _grow(mask: np.ndarray, share: float) -> np.ndarray:
    """The mask grown by a share of the square root of its area."""
    radius = max(1, round(share * float(np.sqrt(mask.sum()))))
    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3) <= radius
