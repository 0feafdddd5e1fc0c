"""Is a reconstruction right? Answered from the images alone, because one that hangs together can be wrong.

A low reprojection error says only that the matches that were kept agree with each other. The masks were not used to
find the cameras, so they are a witness of their own: every ray through a mask must somewhere pass through the masks of
all other views (the visual hull, Laurentini 1994). A camera that stands wrong sees mask rays that no other view can
explain, and spoils the rays of the others.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras import Camera


@dataclass(frozen=True)
class SilhouetteCoherence:
    """How well the masks agree under the cameras.

    Attributes:
        names: image names.
        unexplained_px: (N,) per view, how far (95th percentile over its mask rays) the best point of a ray stays outside
            the worst other mask; pixels at the size of the capture.
        disagreement_px: (N, N) per pair, the 95th percentile of how far view j's mask misses the rays of view i.
    """

    names: tuple[str, ...]
    unexplained_px: np.ndarray
    disagreement_px: np.ndarray

    def culprit(self) -> str:
        """The view that disagrees most with the others, over both directions of its pairs."""
        return self.names[int((self.disagreement_px + self.disagreement_px.T).sum(1).argmax())]


def measure_silhouette_coherence(
    cameras: list[Camera], masks: dict[str, np.ndarray], rays_per_view: int = 200, steps: int = 160
) -> SilhouetteCoherence:
    """Walk along mask rays of every view and measure how far outside the other masks they stay.

    Args:
        cameras: registered pinhole cameras.
        masks: {image name: (height, width) bool}, of the cameras' sizes.
        rays_per_view: mask pixels tested a view, evenly spread, half of them on the mask's rim.
        steps: depths tested along each ray.
    """
    names = tuple(camera.name for camera in cameras)
    distance = [_compute_signed_distance_px(masks[name]) for name in names]
    centre, radius = bound_object(cameras, [masks[name] for name in names])
    count = len(cameras)
    unexplained, disagreement = np.zeros(count), np.zeros((count, count))
    for i, camera in enumerate(cameras):
        pixels = _choose_mask_pixels(masks[names[i]], rays_per_view)
        inside = np.full((count, len(pixels), steps), np.inf, dtype=np.float32)
        world_from_camera = np.linalg.inv(camera.camera_from_world)
        rays = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(camera.intrinsics).T
        depth = float((camera.camera_from_world @ [*centre, 1.0])[2])
        depths = np.linspace(max(depth - radius, 0.05 * depth), depth + radius, steps)
        points = (rays[:, None] * depths[:, None]).reshape(-1, 3) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
        for j, other in enumerate(cameras):
            if j != i:
                inside[j] = _look_up(distance[j], other, points).reshape(len(pixels), steps)
        worst = inside.min(0)
        best = worst.argmax(1)
        unexplained[i] = np.percentile(np.maximum(-worst.max(1), 0), 95)
        disagreement[i] = np.percentile(np.maximum(-inside[:, np.arange(len(pixels)), best], 0), 95, axis=1)
    return SilhouetteCoherence(names, unexplained, disagreement)


def bound_object(cameras: list[Camera], masks: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """A sphere about the object in the world frame: centred where the rays through the mask centres meet."""
    origins, directions, extents = [], [], []
    for camera, mask in zip(cameras, masks, strict=True):
        y, x = np.nonzero(mask)
        middle = np.array([x.mean() + 0.5, y.mean() + 0.5, 1.0])
        ray = camera.camera_from_world[:3, :3].T @ np.linalg.inv(camera.intrinsics) @ middle
        origins.append(camera.centre_in_world)
        directions.append(ray / np.linalg.norm(ray))
        extents.append(np.hypot(np.ptp(x) + 1, np.ptp(y) + 1) / camera.intrinsics[0, 0])
    origins, directions = np.array(origins), np.array(directions)
    across = np.eye(3) - directions[:, :, None] * directions[:, None]
    weights = np.ones(len(origins))
    for _ in range(20):  # least absolute deviations by reweighting, so that a few wrong cameras do not move the centre
        system = (across * weights[:, None, None]).sum(0)
        centre = np.linalg.solve(system, (across @ origins[:, :, None] * weights[:, None, None]).sum(0)[:, 0])
        miss = np.linalg.norm((across @ (centre - origins)[:, :, None])[..., 0], axis=1)
        weights = 1.0 / np.maximum(miss, 1e-3 * np.median(np.linalg.norm(centre - origins, axis=1)))
    reach = np.array(extents) * np.linalg.norm(centre - origins, axis=1)
    return centre, float(1.2 * np.percentile(reach, 90))


def _compute_signed_distance_px(mask: np.ndarray) -> np.ndarray:
    """(height, width) float32: distance to the mask's rim, positive inside; the image border is no rim."""
    values = mask.astype(np.uint8)
    inside = cv2.distanceTransform(values, cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(1 - values, cv2.DIST_L2, 5)
    return np.where(mask, inside, -outside).astype(np.float32)


def _choose_mask_pixels(mask: np.ndarray, count: int) -> np.ndarray:
    """Up to `count` mask pixel centres (x, y): half on the rim, half inside, evenly spread."""
    eroded = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    chosen = []
    for region in (mask & ~eroded, eroded):
        y, x = np.nonzero(region)
        pick = np.unique(np.linspace(0, len(x) - 1, count // 2).round().astype(int)) if len(x) else np.zeros(0, int)
        chosen.append(np.stack([x[pick] + 0.5, y[pick] + 0.5], axis=1))
    return np.concatenate(chosen)


def _look_up(distance: np.ndarray, camera: Camera, points: np.ndarray) -> np.ndarray:
    """Signed distance at the projections of (P, 3) points: large off the image, where nothing is known, and -large behind the camera."""
    pixels, depth = camera.project(points)
    with np.errstate(invalid="ignore"):
        columns, rows = np.floor(pixels).astype(np.int64).T
    seen = (depth > 0) & (columns >= 0) & (rows >= 0) & (columns < camera.width_px) & (rows < camera.height_px)
    values = np.where(depth > 0, np.float32(1e4), np.float32(-1e4)).astype(np.float32)
    values[seen] = distance[rows[seen], columns[seen]]
    return values
