"""Write a network's matches into a COLMAP database, as keypoints that pairs of images share, and verify them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from zeroshop_steps.register.matching.verified_matches import verify_pairs
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.lenses import import_images, import_with_cameras

PairMatches = Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]
"""By numbers of two images, the first smaller: (M,) numbers of the keypoints that match, in the one and in the other."""


def write_matches(
    database: Path,
    image_set: ImageSet,
    keypoints: list[np.ndarray],
    matches: PairMatches,
    min_track: int,
    seed: int,
    focal_px: float | None = None,
    distorted: bool = True,
    known_cameras: dict[str, pycolmap.Camera] | None = None,
) -> dict[str, int]:
    """Write a camera for each lens, the keypoints of all images and their matches into a new database, and verify these.

    Args:
        database: file to create.
        keypoints: (K, 2) pixels for each image; those of short tracks are left out.
        matches: of the pairs.
        min_track: the fewest keypoints that matches must connect for these to be kept.
        seed: of RANSAC.
        focal_px: known focal length; None reads EXIF, else estimates.
        distorted: whether lenses may be distorted.
        known_cameras: {image stem: camera} to write instead of unknown lenses.

    Returns:
        How many keypoints and matches were kept.
    """
    kept = find_long_tracks([len(points) for points in keypoints], matches, min_track)
    number = [np.cumsum(mask) - 1 for mask in kept]
    if known_cameras is None:
        import_images(database, image_set, focal_px, distorted)
    else:
        import_with_cameras(database, image_set, known_cameras)
    listed, count = [], 0
    with pycolmap.Database.open(database) as opened:
        ids = [opened.read_image_with_name(name).image_id for name in image_set.names]
        for image_id, points, mask in zip(ids, keypoints, kept, strict=True):
            opened.write_keypoints(image_id, points[mask].astype(np.float32).reshape(-1, 2))
        for (first, second), (one, other) in sorted(matches.items()):
            both = kept[first][one] & kept[second][other]
            if both.any():
                numbers = np.stack([number[first][one[both]], number[second][other[both]]], axis=1)
                opened.write_matches(ids[first], ids[second], numbers.astype(np.uint32))
                listed.append((image_set.names[first], image_set.names[second]))
                count += len(numbers)
    verify_pairs(database, listed, seed)
    return {"keypoints": int(sum(mask.sum() for mask in kept)), "matches": count, "matched_pairs": len(listed)}


def find_long_tracks(counts: list[int], matches: PairMatches, min_track: int) -> list[np.ndarray]:
    """For each image (K,) bool: the keypoints that matches connect, themselves included, to at least `min_track`."""
    labels = label_tracks(counts, matches)
    long = np.bincount(labels, minlength=1)[labels] >= min_track
    return np.split(long, np.cumsum(counts)[:-1])


def label_tracks(counts: list[int], matches: PairMatches) -> np.ndarray:
    """For all keypoints, image after image, the number of what matches connect them to."""
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    ends = [(start[first] + one, start[second] + other) for (first, second), (one, other) in matches.items()]
    one, other = (np.concatenate([end[side] for end in ends] or [np.zeros(0, np.int64)]) for side in (0, 1))
    graph = coo_matrix((np.ones(len(one), np.int8), (one, other)), shape=(start[-1], start[-1]))
    return connected_components(graph, directed=False)[1] if start[-1] else np.zeros(0, np.int64)
