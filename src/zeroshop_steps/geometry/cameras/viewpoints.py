"""Where to look from: upright cameras, directions by angle, and directions spread evenly over a sphere."""

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, make_transform

DISTANCE_RADII = 6.0  # of a camera from the middle of the sphere that it shows: little perspective
FILLED = 0.95  # of the shorter side of an image, by the ball around an object that it shows whole
SAME_DIRECTION_DEG = 8.0  # directions that differ by less show the same


def face_along(forward: np.ndarray) -> np.ndarray:
    """(3, 3) camera_from_world of an upright camera (x right, y down, z forward; world z up) that looks along a unit vector.

    The vector must not be vertical.
    """
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def look_at(centre: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) camera_from_world of an upright camera at `centre` that looks at `target`."""
    rotation = face_along((target - centre) / np.linalg.norm(target - centre))
    return make_transform(rotation, -rotation @ centre)


def direction_at(azimuth_rad: float, elevation_rad: float) -> np.ndarray:
    """(3,) unit vector; azimuths turn from +x towards +y, elevations rise towards +z."""
    return np.array([np.cos(elevation_rad) * np.cos(azimuth_rad), np.cos(elevation_rad) * np.sin(azimuth_rad), np.sin(elevation_rad)])


def spread_over_sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """(count,) polar and azimuth angles in radians of directions spread evenly over a sphere (Fibonacci's lattice)."""
    index = np.arange(count) + 0.5
    return np.arccos(1 - 2 * index / count), np.pi * (1 + 5**0.5) * index


def make_intrinsics(focal_px: float, width_px: int, height_px: int) -> np.ndarray:
    """(3, 3) K of a pinhole with square pixels whose principal point is the image's centre."""
    return np.array([[focal_px, 0.0, width_px / 2], [0.0, focal_px, height_px / 2], [0.0, 0.0, 1.0]])


def place_around(middle: np.ndarray, radius: float, direction: np.ndarray, size_px: int) -> Camera:
    """A square, upright camera in a (3,) direction from `middle`, not a vertical one, whose picture a sphere of this radius just fills."""
    centre = middle + DISTANCE_RADII * radius * direction / np.linalg.norm(direction)
    focal_px = size_px / 2 * np.sqrt(DISTANCE_RADII**2 - 1)  # the sphere's tangents from the camera meet the picture's edges
    return Camera("view", size_px, size_px, make_intrinsics(focal_px, size_px, size_px), look_at(centre, middle))
