"""How a hand moves a camera around an object that stands on a table: two loops at different heights, never quite steady.

Slow wandering and quick tremor are sums of sines of random phase, so that the path is smooth and known at every moment.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at, make_intrinsics
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds

DURATION_S = 40.0
TURNS = 2.0  # around the object, in this time
ELEVATIONS_DEG = (30.0, 54.0)
"""Of the two loops; between them the hand rises."""
RISE_SHARE = 0.12  # of the time, in the middle, in which it does
FOCAL_IN_WIDTHS = 0.83  # a phone's main camera while filming: about 30 mm on a full frame
FRAMED_SHARE = 0.62  # of the image's height that the object's diagonal fills
LEAST_DISTANCE_MM = 230.0  # nearer a phone does not focus
WANDER_HZ, TREMOR_HZ = (0.05, 0.35), (1.5, 6.0)
SINES = 4  # whose sum is each component of the noise
# Standard deviations of the hand's way; distance and aim are shares of the distance.
ELEVATION_WANDER_DEG, ROLL_WANDER_DEG, DISTANCE_WANDER, AIM_WANDER = 2.5, 2.0, 0.06, 0.035


class SmoothNoise:
    """A smooth random course of mean 0 and standard deviation about 1 in `dimensions` components."""

    def __init__(self, rng: np.random.Generator, hertz: tuple[float, float], dimensions: int) -> None:
        self._frequencies = rng.uniform(*hertz, (SINES, dimensions))
        self._phases = rng.uniform(0.0, 2 * np.pi, (SINES, dimensions))

    def sample_at(self, time_s: float) -> np.ndarray:
        """(dimensions,) its value at a moment."""
        return np.sin(2 * np.pi * self._frequencies * time_s + self._phases).sum(0) * np.sqrt(2 / SINES)


@dataclass(frozen=True)
class FilmLens:
    """Size of the film's pictures, and their pinhole."""

    width_px: int
    height_px: int

    @property
    def intrinsics(self) -> np.ndarray:
        """(3, 3) matrix K."""
        return make_intrinsics(FOCAL_IN_WIDTHS * self.width_px, self.width_px, self.height_px)


class HandheldCamera:
    """The way of the camera around `bounds`, in its frame (mm, z up); it begins at the object's front."""

    def __init__(self, bounds: ObjectBounds, diagonal_mm: float, lens: FilmLens, rng: np.random.Generator) -> None:
        """`diagonal_mm` is that of the object's box."""
        self._bounds, self.lens = bounds, lens
        framed_mm = diagonal_mm * lens.intrinsics[0, 0] / (FRAMED_SHARE * lens.height_px)
        self.distance_mm = max(framed_mm, LEAST_DISTANCE_MM)
        self._way = SmoothNoise(rng, WANDER_HZ, 7)
        self._tremor = SmoothNoise(rng, TREMOR_HZ, 3)

    def camera_at(self, time_s: float, name: str) -> Camera:
        """The camera at a moment of the film."""
        share = np.clip(time_s / DURATION_S, 0.0, 1.0)
        way = self._way.sample_at(time_s)
        low, high = ELEVATIONS_DEG
        rise = np.clip((share - 0.5) / RISE_SHARE + 0.5, 0.0, 1.0)
        elevation = np.radians(low + (high - low) * rise * rise * (3 - 2 * rise) + ELEVATION_WANDER_DEG * way[0])
        azimuth = np.radians(360.0 * TURNS * share + self._bounds.front_azimuth_deg)
        distance_mm = self.distance_mm * (1 + DISTANCE_WANDER * way[1])
        aim = self._bounds.centre_mm + AIM_WANDER * self.distance_mm * way[2:5]
        direction = direction_at(azimuth, elevation)
        pose = look_at(self._bounds.centre_mm + distance_mm * direction, aim)
        turn = np.eye(4)
        roll = Rotation.from_euler("z", ROLL_WANDER_DEG * way[5], degrees=True)
        turn[:3, :3] = (roll * Rotation.from_rotvec(np.radians(0.22) * self._tremor.sample_at(time_s))).as_matrix()
        return Camera(name, self.lens.width_px, self.lens.height_px, self.lens.intrinsics, turn @ pose)
