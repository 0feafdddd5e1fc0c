"""Where the cameras of a virtual capture stand: the thesis's rings around the object.

Fifty-millimetre lens on a 36 mm sensor, ten azimuths a ring unless told otherwise, distance 3.2 times the object's largest dimension.
World frame: the model's, in mm, z up. Azimuth 0 looks at the object's front, azimuths turn counter-clockwise seen from above.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at, make_intrinsics

LENS_MM, SENSOR_WIDTH_MM = 50.0, 36.0  # Blender's usual camera
DISTANCE_IN_SIZES = 3.2  # of the cameras from the middle, in the largest side of the object
ELEVATIONS_DEG = {"su_l": (0.0, 45.0), "su_h": (0.0, 45.0), "se": (0.0, 45.0, -45.0)}
HELD_OUT_AZIMUTHS_ELEVATIONS_DEG = ((18.0, 20.0), (198.0, 45.0))  # their azimuths are half-way between views of the rings


@dataclass(frozen=True)
class Rings:
    """How many cameras there are, and how high.

    Attributes:
        views: azimuths of a ring, evenly spaced.
        elevations_deg: of the rings; None for the usual ones of the scene.
        least_height_sizes: least height of a camera above the surface, in largest dimensions of the object; 0 takes the rings as they are.
    """

    views: int = 10
    elevations_deg: tuple[float, ...] | None = None
    least_height_sizes: float = 0.5

    def of_scene(self, scene: str) -> tuple[float, ...]:
        """The elevations in a scene."""
        return self.elevations_deg or ELEVATIONS_DEG[scene]


USUAL_RINGS = Rings()


@dataclass(frozen=True)
class ObjectBounds:
    """What the cameras look at.

    Attributes:
        centre_mm: (3,) middle of the object's bounding box.
        largest_mm: the longest edge of that box.
        bottom_mm: z of the support surface.
        front_azimuth_deg: azimuth, from +x towards +y, of the side that the first camera sees.
    """

    centre_mm: np.ndarray
    largest_mm: float
    bottom_mm: float
    front_azimuth_deg: float = 0.0

    @property
    def distance_mm(self) -> float:
        """Distance of every camera from the centre."""
        return DISTANCE_IN_SIZES * self.largest_mm


def place_ring_camera(
    bounds: ObjectBounds, azimuth_deg: float, elevation_deg: float, width_px: int, height_px: int, name: str, least_height_sizes: float
) -> Camera:
    """One camera of a ring.

    At the height of a flat object's centre the lowest ring would skim the surface so closely that nothing of it can be recognised
    (the bowl: 3 degrees). By default, no camera above a surface is therefore lower than half the object's largest dimension, where
    it is at an object that stands on its shortest side (9 degrees); it still looks at the centre, from the same distance.
    """
    elevation = np.radians(elevation_deg)
    if least_height_sizes:
        raised_mm = least_height_sizes * bounds.largest_mm - (bounds.centre_mm[2] - bounds.bottom_mm)
        elevation = max(elevation, np.arcsin(np.clip(raised_mm / bounds.distance_mm, -1.0, 1.0)))
    azimuth = np.radians(azimuth_deg + bounds.front_azimuth_deg)
    direction = direction_at(azimuth, elevation)
    focal_px = width_px * LENS_MM / SENSOR_WIDTH_MM
    intrinsics = make_intrinsics(focal_px, width_px, height_px)
    pose = look_at(bounds.centre_mm + bounds.distance_mm * direction, bounds.centre_mm)
    return Camera(name, width_px, height_px, intrinsics, pose)


def place_capture_cameras(bounds: ObjectBounds, scene: str, width_px: int, height_px: int, rings: Rings) -> tuple[Camera, ...]:
    """The cameras, ring by ring, the first sees the front: usually 20 (su_l, su_h) or 30 (se), from the horizontal ring on."""
    places = [(360.0 * view / rings.views, elevation) for elevation in rings.of_scene(scene) for view in range(rings.views)]
    return _place_cameras(bounds, places, scene, width_px, height_px, rings)


def place_held_out_cameras(bounds: ObjectBounds, scene: str, width_px: int, height_px: int, rings: Rings) -> tuple[Camera, ...]:
    """Two cameras half-way between the azimuths of rings of ten, for judging the result in views that it was not made from."""
    return _place_cameras(bounds, HELD_OUT_AZIMUTHS_ELEVATIONS_DEG, scene, width_px, height_px, rings)


def _place_cameras(
    bounds: ObjectBounds, places: Iterable[tuple[float, float]], scene: str, width_px: int, height_px: int, rings: Rings
) -> tuple[Camera, ...]:
    least_height = 0.0 if scene == "se" else rings.least_height_sizes
    return tuple(
        place_ring_camera(bounds, azimuth, elevation, width_px, height_px, f"{index:06d}.png", least_height)
        for index, (azimuth, elevation) in enumerate(places)
    )
