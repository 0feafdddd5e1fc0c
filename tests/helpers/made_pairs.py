"""What a perfect network would say of pairs of a virtual scene, from its true depth and cameras, with noise added."""

from dataclasses import dataclass

import numpy as np
import torch

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.networks.mast3r.framing import Framing, fit_framing
from zeroshop_steps.networks.mast3r.model import ImagePrediction

WAVES = 12


@dataclass(frozen=True)
class Noise:
    """Standard deviations.

    Attributes:
        feature: of each number of a unit feature.
        point: of points, as a share of their distance.
        scale: of the points of a whole pair, as a share: how well the network knows sizes.
    """

    feature: float = 0.02
    point: float = 0.002
    scale: float = 0.0


class MadePairs:
    """Stands for networks.mast3r.inference.PairPredictor; features are smooth functions of the place in the world."""

    def __init__(self, cameras: list[Camera], depths: list[np.ndarray], unit_m: float, noise: Noise, long_side_px: int = 512) -> None:
        """`depths`: (height, width) along the optical axis in the cameras' unit, 0 where nothing is; `unit_m`: metres a unit."""
        self.noise, self.unit_m = noise, unit_m
        self.cameras = cameras
        self.framings = [fit_framing(camera.width_px, camera.height_px, long_side_px) for camera in cameras]
        pairs = zip(cameras, depths, self.framings, strict=True)
        self.points, self.known = zip(*(_points_in_world(camera, depth, framing) for camera, depth, framing in pairs), strict=True)
        rng = np.random.default_rng(0)
        seen = np.concatenate([points[known] for points, known in zip(self.points, self.known, strict=True)])
        spread = np.std(seen, axis=0).max() if len(seen) else 1.0
        lengths = spread * np.geomspace(0.1, 1.0, WAVES)
        directions = rng.normal(size=(WAVES, 3))
        self.waves = directions / np.linalg.norm(directions, axis=1, keepdims=True) / lengths[:, None]
        self.features = [self._features(points, known, rng) for points, known in zip(self.points, self.known, strict=True)]

    def pair(self, first: int, second: int) -> tuple[ImagePrediction, ImagePrediction]:
        """The points of both in the camera frame of the first, in metres."""
        rng = np.random.default_rng([1, first, second])
        scale = self.unit_m * (1.0 + self.noise.scale * rng.normal())
        pose = self.cameras[first].camera_from_world
        sides = []
        for image in (first, second):
            points = (self.points[image] @ pose[:3, :3].T + pose[:3, 3]) * scale
            points = points * (1.0 + self.noise.point * rng.normal(size=points.shape[:2])[..., None])
            known = torch.from_numpy(self.known[image])[None]
            confidence = torch.where(known, 10.0, 1.01)
            sides.append(
                ImagePrediction(torch.from_numpy(points).float()[None], confidence, self.features[image], torch.where(known, 5.0, 1e-3))
            )
        return sides[0], sides[1]

    def similarities(self) -> torch.Tensor:
        """Of the directions in which the cameras look."""
        axes = np.stack([camera.camera_from_world[2, :3] for camera in self.cameras])
        return torch.from_numpy(axes @ axes.T)

    def _features(self, points: np.ndarray, known: np.ndarray, rng: np.random.Generator) -> torch.Tensor:
        phases = points @ self.waves.T
        features = np.concatenate([np.cos(phases), np.sin(phases)], axis=-1) / np.sqrt(WAVES)
        features += self.noise.feature * rng.normal(size=features.shape)
        features[~known] = rng.normal(size=((~known).sum(), 2 * WAVES))
        return torch.nn.functional.normalize(torch.from_numpy(features).float(), dim=-1)[None]


def _points_in_world(camera: Camera, depth: np.ndarray, framing: Framing) -> tuple[np.ndarray, np.ndarray]:
    """(height, width, 3) what the network's pixels see, and where that is known."""
    columns, rows = np.meshgrid(np.arange(framing.width_px) + 0.5, np.arange(framing.height_px) + 0.5)
    pixels = framing.to_original(np.stack([columns.ravel(), rows.ravel()], axis=1))
    nearest = np.clip(np.floor(pixels).astype(int), 0, [camera.width_px - 1, camera.height_px - 1])
    along = depth[nearest[:, 1], nearest[:, 0]]
    k = camera.intrinsics
    rays = np.concatenate([(pixels - k[:2, 2]) / k[[0, 1], [0, 1]], np.ones((len(pixels), 1))], axis=1)
    in_camera = rays * along[:, None]
    pose = camera.camera_from_world
    world = (in_camera - pose[:3, 3]) @ pose[:3, :3]
    shape = (framing.height_px, framing.width_px)
    return world.reshape(*shape, 3), (along > 0).reshape(shape)
