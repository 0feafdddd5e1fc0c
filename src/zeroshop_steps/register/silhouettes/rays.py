"""Rays through the rims of masks: where each touches the object, and by how much it misses the masks of other views."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.images import sample_bilinear
from zeroshop_steps.register.silhouettes.coherence import choose_rim_pixels
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads

SMOOTHING_PX = 1.0  # of the signed distance: steps of pixels along the rim are not the object's
RIM_ROUNDS = 2  # of moving a pixel's centre onto the rim
MOST_RAYS, MOST_RAYS_OF_VIEW = 4800, 240
DEPTHS, FINER, LEVELS = 64, 9, 2
"""Depths along a ray within the object's sphere, then so many between the neighbours of the best, so often: a ray that only grazes the
object misses by 0.35 px at the best of 64 depths, and by 0.04 px where it touches."""
WORST = 3  # views in which a ray misses most
NEAR_PX = 2.0  # a ray so far inside a mask says nothing about its rim

Place = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
Look = Callable[[int, np.ndarray], np.ndarray]


@dataclass
class RimRays:
    """Rays through rims, and where they touched the object last.

    Attributes:
        view: (R,) number of the view of each ray, ascending.
        pixels: (R, 2) where the ray lies in it, on the mask's rim.
        views: how many views there are.
        depth: (R,) depth of the point of each ray that misses least.
        ray, other, value: (K,) of the views that a ray misses most or grazes: the ray, the view, and the signed distance, px per 1000 px.
    """

    view: np.ndarray
    pixels: np.ndarray
    views: int
    depth: np.ndarray = field(default_factory=lambda: np.zeros(0))
    ray: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    other: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    value: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def choose(cls, masks: Sequence[np.ndarray | None], distances: Sequence[np.ndarray | None]) -> "RimRays":
        """Rays that are spread over the rims of masks, with the signed distances to these; none of views without a mask."""
        each = min(MOST_RAYS_OF_VIEW, MOST_RAYS // len(masks))
        pixels = [
            np.zeros((0, 2)) if mask is None or distance is None else _move_onto_rim(choose_rim_pixels(mask, each), distance)
            for mask, distance in zip(masks, distances, strict=True)
        ]
        return cls(np.repeat(np.arange(len(masks)), [len(part) for part in pixels]), np.concatenate(pixels), len(masks))

    def touch(self, centre_depth: np.ndarray, place: Place, look: Look) -> np.ndarray:
        """Find the depth where each ray misses least, and remember it and the views that it misses most.

        Args:
            centre_depth: (N,) depth of the object's centre in each view, in radii of the object.
            place: (K, 3) points of views' pixels at depths.
            look: a view's signed distances at points, px per 1000 px.

        Returns:
            (R,) the least signed distance there: negative where a ray misses a mask.
        """
        count = len(self.pixels)
        depths = centre_depth[self.view, None] + np.linspace(-1, 1, DEPTHS)
        for level in range(LEVELS + 1):
            inside = self._look_along(depths, place, look)
            least = inside.min(0)
            best = least.argmax(1)
            self.depth = depths[np.arange(count), best]
            if level < LEVELS:
                gap = depths[:, 1] - depths[:, 0]
                depths = self.depth[:, None] + np.linspace(-1, 1, FINER) * gap[:, None]
        there = inside[:, np.arange(count), best]
        other = np.argsort(there, axis=0, kind="stable")[:WORST].ravel()
        ray = np.tile(np.arange(count), min(WORST, self.views))
        value = there[other, ray]
        near = value < NEAR_PX
        self.ray, self.other, self.value = ray[near], other[near], value[near].astype(float)
        return least[np.arange(count), best].astype(float)

    def _look_along(self, depths: np.ndarray, place: Place, look: Look) -> np.ndarray:
        """(N, R, D) signed distance of points of the rays in each view; infinite in their own."""
        steps = depths.shape[1]
        view = np.repeat(self.view, steps)
        points = place(view, np.repeat(self.pixels, steps, axis=0), depths.ravel())
        inside = np.full((self.views, len(points)), np.inf, np.float32)

        def look_from(other: int) -> None:
            first, last = np.searchsorted(view, [other, other + 1])  # its own rays lie together
            found = look(other, np.concatenate([points[:first], points[last:]]))
            inside[other, :first], inside[other, last:] = found[:first], found[first:]

        map_in_threads(look_from, range(self.views))
        return inside.reshape(self.views, -1, steps)


def make_outline_distance(mask: np.ndarray) -> np.ndarray:
    """(height, width) float32 signed distance in pixels to the rim of a mask, positive inside, 0 between its pixels and the others."""
    values = mask.astype(np.uint8)
    within, beyond = (cv2.distanceTransform(part, cv2.DIST_L2, 5) for part in (values, 1 - values))
    signed: np.ndarray = cv2.GaussianBlur(np.where(mask, within - 0.5, 0.5 - beyond).astype(np.float32), (0, 0), SMOOTHING_PX)
    return signed


def look_up_many(values: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(K,) float32 an image at (K, 2) pixels, between its pixels linearly; beyond its border as on it."""
    return sample_bilinear(values, np.clip(pixels - 0.5, -1e4, 1e5), cv2.BORDER_REPLICATE)


def measure_slope(distance: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(K, 2) derivative of a signed distance by the pixel."""
    return np.stack([look_up_many(distance, pixels + step) - look_up_many(distance, pixels - step) for step in 0.5 * np.eye(2)], 1)


def _move_onto_rim(pixels: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Pixels next to a rim, moved along the slope of the signed distance to where this is 0."""
    for _ in range(RIM_ROUNDS):
        slope = measure_slope(distance, pixels)
        steepness = np.maximum((slope**2).sum(1), 0.5 * np.median((slope**2).sum(1)) + 1e-12)
        pixels = pixels - (look_up_many(distance, pixels) / steepness)[:, None] * slope
    return pixels
