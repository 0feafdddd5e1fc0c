"""A cup whose depths and hull are known in closed form."""

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.observation.visual_hull import VisualHull, voxel_centres

RESOLUTION = 48
HALF = 1.0
WALL, FLOOR, RIM = 0.5, -0.3, 0.4


def cup(points: np.ndarray) -> np.ndarray:
    """(P,) bool: inside a cup of radius 0.65 with a hollow of radius 0.5."""
    radius = np.hypot(points[:, 0], points[:, 1])
    solid = (radius < 0.65) & (points[:, 2] > -0.5) & (points[:, 2] < RIM)
    return solid & ~((radius < WALL) & (points[:, 2] > FLOOR))


def camera_above(azimuth_deg: float) -> Camera:
    azimuth, elevation = np.radians(azimuth_deg), np.radians(60.0)
    centre = 4.0 * np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    forward = -centre / np.linalg.norm(centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ centre
    return Camera(f"{azimuth_deg:.0f}.png", 120, 120, np.array([[260.0, 0, 60], [0, 260.0, 60], [0, 0, 1]]), pose)


def depth_of_cup(camera: Camera) -> np.ndarray:
    """(H, W) depth of the cup by marching along each ray, 0 where it misses."""
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    k, pose = camera.intrinsics, camera.camera_from_world
    rays = np.stack([(x + 0.5 - k[0, 2]) / k[0, 0], (y + 0.5 - k[1, 2]) / k[1, 1], np.ones(x.shape)], -1).reshape(-1, 3)
    depth = np.zeros(len(rays))
    for z in np.arange(2.8, 5.2, 0.005):
        open_rays = np.flatnonzero(depth == 0)
        depth[open_rays[cup((rays[open_rays] * z - pose[:3, 3]) @ pose[:3, :3])]] = z
    return depth.reshape(x.shape).astype(np.float32)


def full_hull() -> VisualHull:
    """The cup with its hollow filled, as silhouettes show it."""
    points = voxel_centres(HALF, RESOLUTION)
    filled = (np.hypot(points[:, 0], points[:, 1]) < 0.65) & (points[:, 2] > -0.5) & (points[:, 2] < RIM)
    return VisualHull(filled.reshape((RESOLUTION,) * 3), HALF)
