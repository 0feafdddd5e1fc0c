"""Viewpoints to choose from: on spheres about the object, above what it stands on, and rings of them."""

from dataclasses import dataclass, replace

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import FILLED, direction_at, look_at, spread_over_sphere
from zeroshop_steps.scan.workspace import Box

STEEPEST_DEG = 85.0  # above, "upright" has no meaning


@dataclass(frozen=True)
class ViewSphere:
    """Which viewpoints there are.

    Attributes:
        camera: whose images and lens they have; its pose is not used.
        directions: how many, spread evenly over the sphere; about half of them are above the table.
        least_elevation_deg: of a direction from the object.
        nearest_m: least distance of the camera from the object's middle: what a depth camera measures from.
        distances: in multiples of the one from which the object fills the image.
    """

    camera: Camera
    directions: int = 240
    least_elevation_deg: float = 10.0
    nearest_m: float = 0.25
    distances: tuple[float, ...] = (1.0, 1.25)

    def distance_m(self, extent: Box) -> float:
        """From which the ball around a box fills the image."""
        k, camera = self.camera.intrinsics, self.camera
        # The nearer border on either axis, since the principal point need not be the middle.
        half = min(
            min(k[0, 2], camera.width_px - k[0, 2]) / k[0, 0],
            min(k[1, 2], camera.height_px - k[1, 2]) / k[1, 1],
        )
        return max(self.nearest_m, extent.radius_m / float(np.sin(np.arctan(FILLED * half))))

    def place(self, extent: Box) -> np.ndarray:
        """(N, 4, 4) world_from_camera of upright views of a box's middle, in metres."""
        polar, azimuths = spread_over_sphere(self.directions)
        elevations = np.pi / 2 - polar
        low, high = np.radians([self.least_elevation_deg, STEEPEST_DEG])
        kept = (elevations >= low) & (elevations <= high)
        distance_m = self.distance_m(extent)
        views = [
            _view(extent.centre_m, factor * distance_m, azimuth, elevation)
            for factor in self.distances
            for azimuth, elevation in zip(azimuths[kept], elevations[kept], strict=True)
        ]
        return np.array(views)

    def ring(self, extent: Box, count: int, elevation_deg: float, first_azimuth_deg: float = 0.0) -> np.ndarray:
        """(count, 4, 4) world_from_camera of views at one elevation, evenly spaced."""
        azimuths = np.radians(first_azimuth_deg + 360.0 * np.arange(count) / count)
        distance_m = self.distance_m(extent)
        return np.array([_view(extent.centre_m, distance_m, azimuth, np.radians(elevation_deg)) for azimuth in azimuths])

    def camera_at(self, world_from_camera: np.ndarray) -> Camera:
        """The camera in a pose."""
        return replace(self.camera, camera_from_world=np.linalg.inv(world_from_camera))


def _view(centre_m: np.ndarray, distance_m: float, azimuth_rad: float, elevation_rad: float) -> np.ndarray:
    return np.linalg.inv(look_at(centre_m + distance_m * direction_at(azimuth_rad, elevation_rad), centre_m))
