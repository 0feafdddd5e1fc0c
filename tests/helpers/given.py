"""Cameras as a capture brings them: true ones, with noise, in metres."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.camera_ring import ring_camera
from zeroshop_steps.capture.cameras_json import GivenCamera, GivenCameras, Lens
from zeroshop_steps.geometry.cameras.pinhole import Camera


def small_ring(count: int = 12) -> list[Camera]:
    """Cameras 400 mm around the origin, in mm."""
    return [ring_camera(number, count, 400.0, (10.0, 40.0), (0.0, 0.0, 0.0), 300.0, (160, 120)) for number in range(count)]


def given_cameras(cameras, position_m: float = 0.0, rotation_deg: float = 0.0, stated: bool = True, seed: int = 0) -> GivenCameras:
    """Cameras in mm as given ones in metres, off by normal noise along each axis."""
    rng, images = np.random.default_rng(seed), {}
    for camera in cameras:
        turn = Rotation.from_rotvec(rng.normal(0, np.radians(rotation_deg), 3)).as_matrix()
        pose = np.eye(4)
        pose[:3, :3] = turn @ camera.camera_from_world[:3, :3]
        pose[:3, 3] = -pose[:3, :3] @ (camera.centre_in_world / 1000 + rng.normal(0, position_m, 3))
        images[camera.name] = GivenCamera(Lens.pinhole(camera.intrinsics, (camera.width_px, camera.height_px)), pose)
    deviations = (position_m or None, rotation_deg or None) if stated else (None, None)
    return GivenCameras(images, "a robot's arm", True, *deviations)


def write_lenses(path: Path, names: dict[str, str] | None = None) -> GivenCameras:
    """Write cameras.json of a ring of cameras whose poses are not known, some renamed."""
    given = given_cameras(small_ring())
    known = GivenCameras({(names or {}).get(name, name): GivenCamera(one.lens, None) for name, one in given.images.items()}, "a lab")
    known.write(path)
    return known
