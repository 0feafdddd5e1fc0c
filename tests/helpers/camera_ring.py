"""A ring of cameras that look at one point, made without any renderer."""

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera


def ring_camera(
    index: int, count: int, distance: float, elevations_deg: tuple[float, float], at: tuple[float, float, float], focal_px: float,
    size_px: tuple[int, int],
) -> Camera:  # fmt: skip
    """One of `count` cameras evenly around z, by turns at two heights, `distance` from the origin; x of the picture is level."""
    azimuth, elevation = 2 * np.pi * index / count, np.radians(elevations_deg[1 - index % 2])
    centre = distance * np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    forward = np.array(at) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ centre
    width, height = size_px
    return Camera(f"{index:06d}.png", width, height, np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]]), pose)
