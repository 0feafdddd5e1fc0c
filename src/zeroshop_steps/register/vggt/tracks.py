"""Which points to follow, from which views, and what the network says of them."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.register.vggt.frames import Frames

LEAST_QUALITY = 1e-4  # of a corner, as a share of the best one's; low, so that dull parts get points, too


@dataclass(frozen=True)
class TrackObservations:
    """N points and where S views see them.

    Attributes:
        xy: (S, N, 2) positions in the images of the files.
        seen: (S, N) bool.
        colors: (N, 3) uint8 RGB.
    """

    xy: np.ndarray
    seen: np.ndarray
    colors: np.ndarray


def choose_query_views(cameras: list[Camera], count: int) -> list[int]:
    """The first view, then each time the one that stands farthest from those chosen."""
    centres = np.array([camera.centre_in_world for camera in cameras])
    chosen = [0]
    distance = np.linalg.norm(centres - centres[0], axis=1)
    while len(chosen) < min(count, len(cameras)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(centres - centres[chosen[-1]], axis=1))
        distance[chosen] = -1.0
    return chosen


def choose_query_points(pixels: np.ndarray, usable: np.ndarray, count: int) -> np.ndarray:
    """Up to `count` corners (Shi and Tomasi 1994) of a (3, height, width) image where (height, width) `usable`, evenly spread.

    Returns:
        (N, 2) pixel indices.
    """
    gray = cv2.cvtColor(np.rint(255 * pixels.transpose(1, 2, 0)).astype(np.uint8), cv2.COLOR_RGB2GRAY)
    apart_px = 0.5 * np.sqrt(usable.sum() / count)
    corners = cv2.goodFeaturesToTrack(gray, count, LEAST_QUALITY, max(1.0, apart_px), mask=usable.astype(np.uint8) * 255)
    return np.zeros((0, 2), np.float32) if corners is None else corners.reshape(-1, 2)


def gather_observations(
    frames: Frames,
    usable: np.ndarray,
    queries: dict[int, np.ndarray],
    tracks: dict[int, tuple[np.ndarray, np.ndarray]],
    min_visibility: float,
) -> TrackObservations:
    """All tracks together.

    Args:
        frames: what the network saw.
        usable: (S, height, width) bool: a point elsewhere is not seen.
        queries: {view: (n, 2) pixel indices that were asked for}.
        tracks: {view: (S, n, 2) pixel indices and (S, n) visibility} of these points.
        min_visibility: from where on a point counts as seen.
    """
    count = len(frames.names)
    width, height = frames.network_size_px
    xy, seen, colors = [np.zeros((count, 0, 2))], [np.zeros((count, 0), bool)], [np.zeros((0, 3), np.uint8)]
    for view, points in queries.items():
        places, visibility = tracks[view]
        columns, rows = np.rint(np.nan_to_num(places, nan=-1.0, posinf=-1.0, neginf=-1.0)).astype(np.int64).transpose(2, 0, 1)
        inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
        inside &= usable[np.arange(count)[:, None], np.where(inside, rows, 0), np.where(inside, columns, 0)]
        xy.append(frames.to_image(places.astype(np.float64)))
        seen.append(inside & (visibility > min_visibility))
        at = np.rint(points).astype(int)
        colors.append(np.rint(255 * frames.pixels[view][:, at[:, 1], at[:, 0]].T).astype(np.uint8))
    return TrackObservations(np.concatenate(xy, axis=1), np.concatenate(seen, axis=1), np.concatenate(colors))
