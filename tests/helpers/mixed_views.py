"""A capture whose views have several sizes, some on their side."""

import shutil
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model, write_cameras

QUARTER = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # x right and y down of a picture turned clockwise


def mix_views(capture: Path) -> None:
    """Turn every third view clockwise, reduce every third to three quarters, and the true cameras alike."""
    cameras = []
    for number, camera in enumerate(read_sparse_model(capture / "truth").cameras):
        for part, interpolation in (("images", cv2.INTER_AREA), ("masks", cv2.INTER_NEAREST)):
            path = str(capture / part / camera.name)
            picture = cv2.imread(path, cv2.IMREAD_UNCHANGED)
            if number % 3 == 0:
                picture = cv2.rotate(picture, cv2.ROTATE_90_CLOCKWISE)
            elif number % 3 == 1:
                picture = cv2.resize(picture, None, fx=0.75, fy=0.75, interpolation=interpolation)
            cv2.imwrite(path, picture)
        fx, fy, cx, cy = camera.pinhole_params
        if number % 3 == 0:
            intrinsics = np.array([[fy, 0, camera.height_px - cy], [0, fx, cx], [0, 0, 1]])
            camera = Camera(camera.name, camera.height_px, camera.width_px, intrinsics, QUARTER @ camera.camera_from_world)
        elif number % 3 == 1:
            camera = camera.resized(round(0.75 * camera.width_px), round(0.75 * camera.height_px))
        cameras.append(camera)
    shutil.rmtree(capture / "truth")
    write_cameras(capture / "truth", cameras)
