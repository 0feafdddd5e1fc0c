"""The pinhole camera that planners of views see through, and depth as it sees it, for lenses with distortion."""

import numpy as np

from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.geometry.cameras.pinhole import Camera


def pinhole_camera(lens: Lens, camera_from_world: np.ndarray, name: str = "") -> Camera:
    """A camera with a lens's focal lengths and centre, and no distortion; metres."""
    intrinsics = np.asarray(lens.to_colmap().calibration_matrix(), float)
    return Camera(name, lens.width_px, lens.height_px, intrinsics, camera_from_world)


def flatten_depth(lens: Lens, depth_m: np.ndarray) -> np.ndarray:
    """(height, width) depth of a lens's image as `pinhole_camera` sees it: each pixel that of the nearest pixel, 0 beyond the image."""
    if lens.model in ("PINHOLE", "SIMPLE_PINHOLE"):
        return depth_m
    colmap = lens.to_colmap()
    intrinsics = np.asarray(colmap.calibration_matrix(), float)
    columns, rows = np.meshgrid(np.arange(lens.width_px) + 0.5, np.arange(lens.height_px) + 0.5)
    rays = np.stack([columns, rows, np.ones_like(columns)], -1).reshape(-1, 3) @ np.linalg.inv(intrinsics).T
    places = np.floor(np.asarray(colmap.img_from_cam(rays), float))
    inside = np.isfinite(places).all(1) & (places >= 0).all(1) & (places < (lens.width_px, lens.height_px)).all(1)
    flat = np.zeros(len(rays), depth_m.dtype)
    taken = places[inside].astype(int)
    flat[inside] = depth_m[taken[:, 1], taken[:, 0]]
    return flat.reshape(depth_m.shape)
