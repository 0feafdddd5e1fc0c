"""A red ball on grey noise, from all around: registered pictures with exact masks, made without any renderer."""

from pathlib import Path

import numpy as np

from helpers.camera_ring import ring_camera
from zeroshop_steps.geometry.cameras.pinhole import Camera, write_cameras
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.files import write_json

WIDTH, HEIGHT, FOCAL, RADIUS, DISTANCE = 160, 120, 170.0, 0.6, 3.0
RED = (200, 30, 30)


def ball_cameras(count: int = 12) -> list[Camera]:
    """A ring of cameras at two heights; what they look at is beside the ball, so that it is off the middle of the pictures."""
    return [ring_camera(index, count, DISTANCE, (20, 40), (0.25, 0.1, 0.15), FOCAL, (WIDTH, HEIGHT)) for index in range(count)]


def ball_mask(camera: Camera, centre: tuple[float, float, float] = (0.0, 0.0, 0.0), radius: float = RADIUS) -> np.ndarray:
    """(H, W) bool: where the rays of a camera meet a ball."""
    y, x = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.intrinsics).T @ camera.camera_from_world[:3, :3]
    origin = camera.centre_in_world - centre
    return (rays @ origin) ** 2 > (rays**2).sum(-1) * (origin @ origin - radius**2)


def write_ball_scene(folder: Path, count: int = 12) -> list[np.ndarray]:
    """Write a registered scene; returns the true masks in the order of its images."""
    rng = np.random.default_rng(0)
    cameras = ball_cameras(count)
    masks = [ball_mask(camera) for camera in cameras]
    for camera, mask in zip(cameras, masks, strict=True):
        image = rng.integers(60, 200, (HEIGHT, WIDTH, 1)).repeat(3, 2).astype(np.uint8)
        image[mask] = RED
        write_image(folder / "images" / camera.name, image)
    write_cameras(folder / "sparse", cameras)
    write_json(folder / "registration.json", {"status": "ok", "reason": None, "method": "colmap", "images": count, "registered": count})
    return masks
