"""Leave out pairs of images that match but do not show the same: sides that look alike differ in detail between their matches.

The one picture is carried onto the other by its matches alone, linearly in each triangle between them (Delaunay), so that no cameras are
needed, and textured patches are compared by normalized cross-correlation. The front of a can laid onto its back keeps its matches, but
not the small print between them.
"""

from pathlib import Path

import cv2
import numpy as np
import pycolmap
from scipy.spatial import Delaunay, QhullError

from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.register.photometry.score import WHOLE, compare_patches
from zeroshop_steps.register.photometry.transfer import find_between_matches
from zeroshop_steps.register.scene.database import delete_pair, read_matches, read_places
from zeroshop_steps.register.scene.image_set import ImageSet, read_masks
from zeroshop_steps.runtime.progress import track

SIDE_PX = 200  # longer side of the object in the small copies that are compared
PATCH_PX, PLAY_PX = 11, 2  # of the small copies: what is compared, and how far it may lie beside its place
LONGEST_EDGE = 0.35  # of a triangle, as a share of `SIDE_PX`: in larger ones the surface is not flat
LEAST_PATCHES = 8  # of a picture that is judged
LEAST_SCORE, UNLIKE_SCORE, UNLIKE_SHARE = 0.9, 0.6, 0.08
"""The median patch must reach the first score, and at most so many may stay below the second. Right pairs: 0.87 to 0.97, and up to 0.1;
of 42 pairs of opposite sides of a can and a bottle, four that have fewer than 35 patches or bridge 70 degrees pass."""


def delete_inconsistent_pairs(database: Path, image_set: ImageSet) -> list[tuple[str, str]]:
    """Delete the pairs of a database whose pictures differ between their matches, or show too little; returns the images' names.

    Args:
        database: with verified matches; changed in place.
        image_set: the images, with masks.
    """
    masks = read_masks(image_set)
    greys = {path.name: cv2.cvtColor(read_image(path), cv2.COLOR_RGB2GRAY).astype(np.float32) for path in image_set.images}
    unlike = []
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: image.name for image in opened.read_all_images()}
        places, pairs = read_places(opened), read_matches(opened)
        for ends, numbers in track(pairs, "comparing pairs", len(pairs)):
            if not len(numbers):
                continue
            one, other = ((greys[names[end]], masks[names[end]], places[end][numbers[:, side]]) for side, end in enumerate(ends))
            scores = [part for part in (compare_between(*one, *other), compare_between(*other, *one)) if len(part) >= LEAST_PATCHES]
            if not scores or not _show_the_same(scores):
                unlike.append((names[ends[0]], names[ends[1]]))
                delete_pair(opened, *ends)
    return sorted(unlike)


def compare_between(
    grey: np.ndarray, mask: np.ndarray, points: np.ndarray, other_grey: np.ndarray, other_mask: np.ndarray, other_points: np.ndarray
) -> np.ndarray:
    """How well patches of one picture are found in another that is carried onto it by matches.

    Args:
        grey, mask: (H, W) float32 and bool, a picture and the object in it; `other_` likewise.
        points, other_points: (M, 2) pixels that match; the centre of the first pixel is (0.5, 0.5).

    Returns:
        (P,) scores from -1 to 1 of the textured patches.
    """
    rows, columns = np.nonzero(mask)
    scale = SIDE_PX / (max(np.ptp(rows), np.ptp(columns)) + 1)
    corner = np.array([columns.min(), rows.min()], float)
    width_px, height_px = (int((np.ptp(side) + 1) * scale) + 1 for side in (columns, rows))
    try:
        triangles = Delaunay((points - corner) * scale)
    except (QhullError, ValueError):
        return np.zeros(0)
    places = find_between_matches(triangles, other_points, width_px, height_px, LONGEST_EDGE * SIDE_PX)
    blur_px = max(0.3, 0.5 / scale)
    to_small = np.array([[scale, 0.0, (0.5 - corner[0]) * scale - 0.5], [0.0, scale, (0.5 - corner[1]) * scale - 0.5]])
    small = cv2.warpAffine(cv2.GaussianBlur(grey, (0, 0), blur_px), to_small, (width_px, height_px))
    carried = cv2.remap(cv2.GaussianBlur(other_grey, (0, 0), blur_px), places[..., 0], places[..., 1], cv2.INTER_LINEAR)
    seen = cv2.warpAffine(mask.astype(np.uint8), to_small, (width_px, height_px), flags=cv2.INTER_NEAREST) > 0
    seen &= cv2.remap(other_mask.astype(np.uint8), places[..., 0], places[..., 1], cv2.INTER_NEAREST) > 0
    whole = cv2.boxFilter(seen.astype(np.float32), -1, (PATCH_PX, PATCH_PX)) >= WHOLE
    return compare_patches(small, carried, whole, PATCH_PX, PLAY_PX)


def _show_the_same(scores: list[np.ndarray]) -> bool:
    median = float(np.mean([np.median(part) for part in scores]))
    unlike = float(np.mean([(part < UNLIKE_SCORE).mean() for part in scores]))
    return median >= LEAST_SCORE and unlike <= UNLIKE_SHARE
