"""Depth maps and points: (H, W) depth along a camera's optical axis, 0 where nothing is known."""

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera


def ray_slopes(camera: Camera, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(P, 2) slopes x / z and y / z, in the camera's frame, of the rays through the centres of pixels in rows y and columns x."""
    k = camera.intrinsics
    return np.stack([(x + 0.5 - k[0, 2]) / k[0, 0], (y + 0.5 - k[1, 2]) / k[1, 1]], 1)


def unproject(camera: Camera, depth: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(P, 3) points in the world that a depth map shows at pixels in rows y and columns x."""
    pose = camera.camera_from_world
    rays = np.concatenate([ray_slopes(camera, y, x), np.ones((len(x), 1))], axis=1)
    return (rays * depth[y, x][:, None] - pose[:3, 3]) @ pose[:3, :3]


def look_up_depths(camera: Camera, depth: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a depth map holds at the pixels that (P, 3) points in the world project to.

    Returns:
        (K,) indices of the points that project into the image, (K,) the depth map's values there, and (K,) the points' own
        depths.
    """
    pixels, z = camera.project(points)
    x, y = np.floor(pixels).astype(int).T
    framed = np.flatnonzero((x >= 0) & (y >= 0) & (x < camera.width_px) & (y < camera.height_px))
    return framed, depth[y[framed], x[framed]], z[framed]


def find_gaps(camera: Camera, depth: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P,) how far a depth map lies behind each of (P, 3) points in the world; NaN where it has none."""
    framed, found, own = look_up_depths(camera, depth, points)
    gap = np.full(len(points), np.nan)
    gap[framed] = np.where(found > 0, found - own, np.nan)
    return gap
