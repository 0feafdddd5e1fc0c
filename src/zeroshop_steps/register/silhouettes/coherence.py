"""Check cameras by the masks, which had no part in finding them.

A low reprojection error only says that the matches that were kept agree with each other. Every ray through a mask must also
pass somewhere through the masks of all other views (the visual hull, Laurentini 1994). A wrong camera has mask rays that miss
other masks, and makes rays of the other cameras miss its own.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.ray_convergence import find_nearest_point
from zeroshop_steps.geometry.cameras.transforms import shrink_camera
from zeroshop_steps.register.scene.image_set import REFERENCE_PX
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads

RADIUS_MARGIN, RADIUS_PERCENTILE = 1.2, 90  # of the object's sphere: all of the object, but not for the size of a wrong mask
NEAREST_DEPTH = 0.05  # share of the depth of the object's centre at which rays start where the sphere holds the camera
MISS_PERCENTILE = 95  # of the distances by which the rays of a view miss the other masks: single bad mask pixels do not count
RAYS, STEPS = 200, 160  # pixels that are tested of a view, half of them on its mask's rim, and depths along the ray of each
AGREEING_SHARE = MISS_PERCENTILE / 100  # of a mask's rays that lie in another mask, in the mean over the others, and of theirs in it
UNEXPLAINED_PX = 6.0  # rays of a mask may miss the other masks by this much, per 1000 px: set on virtual captures of 32 objects
UNSEEN_PX = 1e4  # in place of a signed distance: a point off the image may lie in the mask, one behind the camera cannot


@dataclass(frozen=True)
class SilhouetteCoherence:
    """How well the masks agree under the cameras.

    Attributes:
        names: image names.
        unexplained_px: (N,) for each view, the distance in pixels by which its mask rays miss the other masks: at the best point of
            each ray, from the mask that is farthest (95th percentile over the rays).
        disagreement_px: (N, N) for each pair, the distance in pixels by which the rays of view i miss the mask of view j (95th
            percentile).
    """

    names: tuple[str, ...]
    unexplained_px: np.ndarray
    disagreement_px: np.ndarray

    def culprit(self) -> str:
        """The view that disagrees most with the others, in both directions."""
        return self.names[int((self.disagreement_px + self.disagreement_px.T).sum(1).argmax())]

    def enlarged(self, factors: Mapping[str, float]) -> "SilhouetteCoherence":
        """The same in pixels of images that are larger by these factors."""
        by_view = np.array([factors[name] for name in self.names])
        return SilhouetteCoherence(self.names, self.unexplained_px * by_view, self.disagreement_px * by_view)


def shrink_masks(cameras: list[Camera], masks: dict[str, np.ndarray]) -> tuple[list[Camera], dict[str, np.ndarray]]:
    """Cameras and masks of images of at most `REFERENCE_PX`: all limits are far above a pixel of these, and time grows with the pixels."""
    small = [shrink_camera(camera, REFERENCE_PX) for camera in cameras]
    return small, {
        camera.name: cv2.resize(masks[camera.name].astype(np.float32), (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA)
        > 0.5
        for camera in small
    }


def measure_silhouette_coherence(cameras: list[Camera], masks: dict[str, np.ndarray]) -> SilhouetteCoherence:
    """Measure how far the mask rays of every view miss the masks of the others.

    Args:
        cameras: registered pinhole cameras.
        masks: {image name: (height, width) bool}, of the cameras' sizes.
    """
    count = len(cameras)
    unexplained, disagreement = np.zeros(count), np.zeros((count, count))
    for i, inside in enumerate(_cast_mask_rays(cameras, masks)):
        worst = inside.min(0)
        best = worst.argmax(1)
        unexplained[i] = np.percentile(np.maximum(-worst.max(1), 0), MISS_PERCENTILE)
        disagreement[i] = np.percentile(np.maximum(-inside[:, np.arange(len(best)), best], 0), MISS_PERCENTILE, axis=1)
    return SilhouetteCoherence(tuple(camera.name for camera in cameras), unexplained, disagreement)


def find_doubtful_mask(cameras: list[Camera], masks: dict[str, np.ndarray]) -> str:
    """The name of the view without whose mask the rays of the others miss least; arguments as above, of at least two views."""
    return cameras[int(measure_misses_without(cameras, masks).sum(1).argmin())].name


def measure_misses_without(cameras: list[Camera], masks: dict[str, np.ndarray]) -> np.ndarray:
    """(N, N) px: by how much the mask rays of view i miss the other masks where that of view j is left out, at [j, i]; 0 where i is j."""
    count = len(cameras)
    without = np.zeros((count, count))
    for i, inside in enumerate(_cast_mask_rays(cameras, masks)):
        worst, blocking = inside.min(0), inside.argmin(0)
        second = np.partition(inside, 1, axis=0)[1] if count > 2 else worst
        for j in range(count):
            if j != i:
                left = np.where(blocking == j, second, worst).max(1)
                without[j, i] = np.percentile(np.maximum(-left, 0), MISS_PERCENTILE)
    return without


def find_wrong_masks(cameras: list[Camera], masks: dict[str, np.ndarray], limits_px: np.ndarray) -> list[str]:
    """Names of the images whose masks contradict most of the others: a part is missing, or something else is in them.

    A ray's object is where most masks have it, so that a few wrong masks do not matter. The mask that agrees least is taken out until
    all that are left agree.

    Args:
        cameras, masks: as above.
        limits_px: (N,) by how much a ray may miss the mask of each view.
    """
    count = len(cameras)
    agreement = np.ones((count, count))  # share of the rays of view i that lie in the mask of view j, of those that it sees
    for i, inside in enumerate(_cast_mask_rays(cameras, masks)):
        missed = inside < -limits_px[:, None, None]
        held = ~missed & (inside < UNSEEN_PX)
        best = (held.sum(0, dtype=int) - missed.sum(0, dtype=int)).argmax(1)
        rays = np.arange(len(best))
        within, without = held[:, rays, best].sum(1), missed[:, rays, best].sum(1)
        agreement[i] = np.where(within + without > 0, within / np.maximum(within + without, 1), 1.0)
        agreement[i, i] = 1.0
    kept = list(range(count))
    while len(kept) > 1:
        among = agreement[np.ix_(kept, kept)]
        others = len(kept) - 1
        scores = np.minimum((among.sum(0) - 1) / others, (among.sum(1) - 1) / others)
        if scores.min() >= AGREEING_SHARE:
            break
        del kept[int(scores.argmin())]
    return [camera.name for index, camera in enumerate(cameras) if index not in kept]


def _cast_mask_rays(cameras: list[Camera], masks: dict[str, np.ndarray]) -> Iterator[np.ndarray]:
    """For each view, (N, P, STEPS) float32: how far points of its P mask rays lie in the mask of each view, px; infinite for its own."""
    chosen = [masks[camera.name] for camera in cameras]
    distance = [_compute_signed_distance_px(mask) for mask in chosen]
    centre, radius = bound_object(cameras, chosen)
    for i, camera in enumerate(cameras):
        pixels = np.concatenate([choose_rim_pixels(chosen[i], RAYS // 2), _spread(_erode(chosen[i]), RAYS // 2)])
        world_from_camera = np.linalg.inv(camera.camera_from_world)
        rays = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(camera.intrinsics).T
        depth = float((camera.camera_from_world @ [*centre, 1.0])[2])
        depths = np.linspace(max(depth - radius, NEAREST_DEPTH * depth), depth + radius, STEPS)
        points = (rays[:, None] * depths[:, None]).reshape(-1, 3) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
        others = [j for j in range(len(cameras)) if j != i]
        found = map_in_threads(partial(_look_up, points), [distance[j] for j in others], [cameras[j] for j in others])
        inside = np.full((len(cameras), len(pixels), STEPS), np.inf, dtype=np.float32)
        for j, values in zip(others, found, strict=True):
            inside[j] = values.reshape(len(pixels), STEPS)
        yield inside


def bound_object(cameras: list[Camera], masks: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Centre and radius of a sphere about the object, in the world frame, also where a few cameras are wrong.

    The centre is where the rays through the masks' centroids meet. `crops.fit_object_sphere`, which surfaces are optimized in, is
    exact where all cameras are right, and follows wrong ones.
    """
    origins, directions, extents = [], [], []
    for camera, mask in zip(cameras, masks, strict=True):
        y, x = np.nonzero(mask)
        origins.append(camera.centre_in_world)
        directions.append(camera.find_ray(x.mean() + 0.5, y.mean() + 0.5))
        extents.append(np.hypot(np.ptp(x) + 1, np.ptp(y) + 1) / camera.intrinsics[0, 0])
    centre = find_nearest_point(np.array(origins), np.array(directions))
    reach = np.array(extents) * np.linalg.norm(centre - np.array(origins), axis=1)
    return centre, float(RADIUS_MARGIN * np.percentile(reach, RADIUS_PERCENTILE))


def _compute_signed_distance_px(mask: np.ndarray) -> np.ndarray:
    """(height, width) float32 distance to the mask's rim, positive inside. The image border is not a rim."""
    values = mask.astype(np.uint8)
    inside = cv2.distanceTransform(values, cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(1 - values, cv2.DIST_L2, 5)
    return np.where(mask, inside, -outside).astype(np.float32)


def choose_rim_pixels(mask: np.ndarray, count: int) -> np.ndarray:
    """Up to `count` pixel centres (x, y) along the rim of a mask, evenly spread; the image's border is not a rim."""
    return _spread(mask & ~_erode(mask), count)


def _erode(mask: np.ndarray) -> np.ndarray:
    inner: np.ndarray = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    return inner


def _spread(region: np.ndarray, count: int) -> np.ndarray:
    y, x = np.nonzero(region)
    pick = np.unique(np.linspace(0, len(x) - 1, count).round().astype(int)) if len(x) else np.zeros(0, int)
    return np.stack([x[pick] + 0.5, y[pick] + 0.5], axis=1)


def _look_up(points: np.ndarray, distance: np.ndarray, camera: Camera) -> np.ndarray:
    """Signed distances at the projections of (P, 3) points; `UNSEEN_PX` off the image and -`UNSEEN_PX` behind the camera."""
    rows, columns, depth, seen = camera.find_pixels(points)
    values = np.where(depth > 0, np.float32(UNSEEN_PX), np.float32(-UNSEEN_PX)).astype(np.float32)
    values[seen] = distance[rows[seen], columns[seen]]
    return values
