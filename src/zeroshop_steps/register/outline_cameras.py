"""Between the ways of `outline_search`, in which views stand around an object, and pinhole cameras."""

import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.register.image_set import ImageSet
from zeroshop_steps.register.outline_search import Way
from zeroshop_steps.register.outline_tangents import SIZE, Outlines


def make_cameras(way: Way, outlines: Outlines, image_set: ImageSet, focal_px: np.ndarray) -> list[Camera]:
    """Pinhole cameras of a way, in its frame."""
    return [
        Camera(name, *size_px, _make_intrinsics(guess * np.exp(way.log_focal), size_px), pose)
        for name, size_px, guess, pose in zip(image_set.names, image_set.sizes_px, focal_px, way.make_poses(outlines), strict=True)
    ]


def read_way(cameras: list[Camera], outlines: Outlines, focal_px: np.ndarray) -> Way:
    """The way that cameras stand in, whose frame is that of a way."""
    log_focal = float(np.log(cameras[0].intrinsics[0, 0] / focal_px[0]))
    views = np.zeros((len(cameras), SIZE))
    for view, camera, middle in zip(views, cameras, outlines.middle, strict=True):
        right, down, ahead = camera.camera_from_world[:3, :3]
        place = camera.camera_from_world[:3, 3]
        view[0], view[1] = np.arctan2(-ahead[1], -ahead[0]), np.arcsin(-ahead[2])
        level = np.array([-np.sin(view[0]), np.cos(view[0]), 0.0])
        view[2] = np.arctan2(-(level @ down), level @ right)
        view[3:5] = place[:2] / place[2] - middle * np.exp(-log_focal)
        view[5] = np.log(place[2])
    return Way(views, log_focal)


def _make_intrinsics(focal_px: float, size_px: tuple[int, int]) -> np.ndarray:
    return np.array([[focal_px, 0.0, size_px[0] / 2], [0.0, focal_px, size_px[1] / 2], [0.0, 0.0, 1.0]])
