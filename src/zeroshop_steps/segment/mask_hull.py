"""Masks and hull of one object, in alternation: cut each photo by the odds of all cues, then carve what the masks share.

The energy is that of a labelling of all photos: the log odds of the cues, which include the hull's silhouette, and the length of the
outlines, less along edges of the photos. With the hull fixed, each photo's cut is its global minimum (segment/outlines/graph_cut.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.geometry.support.scene_support import SceneSupport
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.segment.cues import MOST_ODDS
from zeroshop_steps.segment.cues.fusion import estimate_odds
from zeroshop_steps.segment.ground_picture import build_ground_picture
from zeroshop_steps.segment.objects import NothingFound, ObjectBlock
from zeroshop_steps.segment.outlines.graph_cut import cut_image
from zeroshop_steps.segment.scene import Guess, Hull, MaskScene
from zeroshop_steps.segment.support_voxels import Votes, VoxelGrid, carve, count_votes, render_shares, render_silhouettes, splat_voxels

ROUNDS, SETTLED_OVERLAP = 3, 0.99  # at most; and the overlap of a round's hull with the one before from which on masks hardly change
FLAT_SHARE, FLAT_VOXELS = 0.06, 2.0
"""Columns no higher than this share of the hull's height, or than so many voxels, are print or shadows on the ground."""
HIDDEN = 0.03  # around the object, in square roots of its area, the ground is not looked at: its outline is not exact
NEAR_VOXELS = 2  # parts of the hull so near to each other are connected


@dataclass(frozen=True)
class Solution:
    """Masks and their common hull.

    Attributes:
        guess: what the last round started from.
        odds: (h, w) float32 log odds of the last round, in every view.
        masks: (h, w) float32 in [0, 1], above 1/2 on the object.
        hulls: (h, w) bool: the silhouettes of the voxels that the masks share.
        grid, occupied: these voxels.
    """

    guess: Guess
    odds: list[np.ndarray]
    masks: list[np.ndarray]
    hulls: list[np.ndarray]
    grid: VoxelGrid
    occupied: np.ndarray


def solve(scene: MaskScene, support: SceneSupport | None, block: ObjectBlock, votes: Votes, without: Sequence[str] = ()) -> Solution:
    """Alternate between cutting the photos and carving the hull of the masks.

    Args:
        scene: the photos, or windows of them around the object.
        support: the plane; None where there is none.
        block: the object as it was found.
        votes: of all views on the voxels that may be its own, `block.index`, before there is a hull.
        without: cues that are not asked.

    Raises:
        NothingFound: the masks share nothing.
    """
    occupied, standing = _drop_flat(block.occupied, block.ground_voxel)
    rooms = render_silhouettes(block.grid, block.allowed, scene.cameras)
    others = map_in_threads(lambda camera: splat_voxels(block.other_points, block.other_side, camera), scene.cameras)
    for _ in range(ROUNDS):
        hulls = render_silhouettes(block.grid, occupied, scene.cameras)
        upright = standing[tuple(block.index[:, :2].T)]
        shares = render_shares(block.grid, block.index[upright], votes.take(upright), scene.cameras)
        guess = make_guess(scene, support, Hull(occupied, hulls, shares, others))
        odds = estimate_odds(scene, guess, without)
        masks = map_in_threads(_cut_within, rooms, odds, scene.images)
        votes = count_votes(block.grid, block.index, scene.cameras, [2 * mask - 1 for mask in masks])
        before, (occupied, standing) = occupied, _drop_flat(carve(block.grid, block.index, votes), block.ground_voxel)
        occupied = _keep_connected(occupied)
        if not occupied.any():
            raise NothingFound(
                "the masks of the photos have nothing in common; put the object alone on a ground of other colours, do not move it, or draw"
                " masks and name their folder in objects.tsv"
            )
        if compute_overlap(before, occupied) >= SETTLED_OVERLAP:
            break
    return Solution(guess, odds, masks, render_silhouettes(block.grid, occupied, scene.cameras), block.grid, occupied)


def make_guess(scene: MaskScene, support: SceneSupport | None, hull: Hull) -> Guess:
    """What is known of an object with this hull on this plane."""
    ground = None
    if support is not None:
        hidden = [_grow(silhouette) | other for silhouette, other in zip(hull.silhouettes, hull.others, strict=True)]
        ground = build_ground_picture(support, scene.cameras, scene.images, hidden)
    return Guess(support, ground, hull)


def _grow(silhouette: np.ndarray) -> np.ndarray:
    """The (h, w) bool silhouette and what is close around it."""
    away = cv2.distanceTransform((~silhouette).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(away <= HIDDEN * np.sqrt(silhouette.sum())) & silhouette.any()


def _cut_within(room: np.ndarray, odds: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Cut the part of an image in which the object may be; the rest is background."""
    y, x = np.nonzero(room)
    mask = np.zeros(room.shape, np.float32)
    if len(y):
        crop = (slice(max(y.min() - 2, 0), y.max() + 3), slice(max(x.min() - 2, 0), x.max() + 3))
        mask[crop] = cut_image(np.where(room[crop], odds[crop], -2 * MOST_ODDS), image[crop])
    return mask


def _drop_flat(occupied: np.ndarray, ground_voxel: float) -> tuple[np.ndarray, np.ndarray]:
    """Drop columns that hardly rise above the ground: print, paper and shadows agree between views, too, but are flat.

    Returns:
        The (X, Y, Z) bool voxels that are left, and (X, Y) bool: the columns without flat ones.
    """
    layers = np.flatnonzero(occupied.any(axis=(0, 1)))
    if ground_voxel < 0 or not len(layers):
        return occupied, np.ones(occupied.shape[:2], bool)
    top = np.where(occupied.any(axis=2), occupied.shape[2] - occupied[:, :, ::-1].argmax(axis=2), np.inf)
    standing = top - ground_voxel > max(FLAT_SHARE * (layers[-1] - ground_voxel), FLAT_VOXELS)
    kept = occupied & standing[:, :, None]
    return (kept, standing) if kept.any() else (occupied, np.ones(occupied.shape[:2], bool))


def _keep_connected(occupied: np.ndarray) -> np.ndarray:
    """The largest part, and those that are hardly smaller or nearly touch it."""
    labels, count = ndimage.label(ndimage.binary_dilation(occupied, iterations=NEAR_VOXELS), np.ones((3, 3, 3)))
    if count < 2:
        return occupied
    sizes = np.bincount(labels[occupied], minlength=count + 1)
    return np.asarray(occupied & np.isin(labels, np.flatnonzero(sizes >= 0.5 * sizes.max())))


def close_holes(mask: np.ndarray, odds: np.ndarray) -> np.ndarray:
    """Fill the holes of an (H, W) float32 mask whose odds are above even in the mean: print may have the ground's colours."""
    count, labels = cv2.connectedComponents((mask <= 0.5).astype(np.uint8), connectivity=4)
    rim = np.unique(np.concatenate([labels[[0, -1]].ravel(), labels[:, [0, -1]].ravel()]))
    likely = np.asarray(ndimage.mean(odds, labels, np.arange(count))) > 0
    likely[rim] = likely[0] = False
    return np.where(likely[labels], np.float32(1), mask)
