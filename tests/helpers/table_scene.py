"""Balls on a printed table or on a plain one, drawn by their equations: what a film may show that it should not."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from helpers.camera_ring import ring_camera
from zeroshop_steps.geometry.cameras.pinhole import Camera, SparseModel
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.images import write_image

WIDTH, HEIGHT, FOCAL, DISTANCE, COUNT = 240, 180, 260.0, 4.0, 12
BROWN = np.array([121.0, 99.0, 77.0])
Ball = tuple[float, float, float]  # x and y of its foot, radius


def table_views(
    folder: Path, balls_in: list[list[Ball]], plain: bool = False, sheet: float = 0.0, leaflet: Ball | None = None
) -> tuple[list[View], SparseModel]:
    """Write a view for each list of balls; returns the views and what a registration knows of the scene.

    Args:
        folder: for the images.
        balls_in: the balls that each view shows, of views evenly around the table's middle at two heights.
        plain: a white table that shows nothing but the soft shadows of the first view's balls, and no points.
        sheet: half the side of a square white sheet in the middle of the plain table, which is brown then.
        leaflet: x and y of the middle of a square printed one on the plain table, and half its side.
    """
    rng = np.random.default_rng(0)
    print_ = (
        _plain_top(balls_in[0], sheet)
        if plain
        else cv2.resize(rng.integers(20, 236, (160, 160, 3), np.uint8), (640, 640), interpolation=cv2.INTER_CUBIC).astype(np.float32)
    )
    if leaflet:
        _lay_leaflet(print_, leaflet)
    views, points = [], [np.c_[rng.uniform(-1.6, 1.6, (0 if plain else 600, 2)), np.zeros(0 if plain else 600)]]
    for index, balls in enumerate(balls_in):
        camera = ring_camera(index, len(balls_in), DISTANCE, (25, 45), (0.0, 0.0, 0.3), FOCAL, (WIDTH, HEIGHT))
        image, on_balls = _drawn(camera, balls, print_, rng)
        path = folder / "images" / camera.name
        write_image(path, image)
        views.append(View(camera, path, None))
        points.append(on_balls)
    points = np.concatenate(points)
    cameras = tuple(view.camera for view in views)
    seen = tuple(_find_seen(camera, balls, points) for camera, balls in zip(cameras, balls_in, strict=True))
    model = SparseModel(cameras, points, np.zeros((len(points), 3), np.uint8), np.full(len(points), 3), seen)
    return views, model


@dataclass(frozen=True)
class FoundMasks:
    """What a search for masks is taken to have found."""

    masks: list[np.ndarray]
    record: dict


def look_along(camera: Camera) -> np.ndarray:
    """(H, W, 3) directions of the pixels' rays in the world, of depth 1."""
    y, x = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    return np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.intrinsics).T @ camera.camera_from_world[:3, :3]


def ball_mask(camera: Camera, ball: Ball) -> np.ndarray:
    """(H, W) bool: the pixels whose rays meet the ball."""
    rays = look_along(camera)
    away = camera.centre_in_world - np.array(ball)
    return (rays @ away) ** 2 > (rays**2).sum(-1) * (away @ away - ball[2] ** 2)


def _find_seen(camera: Camera, balls: list[Ball], points: np.ndarray) -> np.ndarray:
    """The rows of the (P, 3) points on the table and on the balls of this view that no ball hides."""
    seen = points[:, 2] == 0
    for foot_x, foot_y, radius in balls:
        seen |= np.abs(np.linalg.norm(points - [foot_x, foot_y, radius], axis=1) - radius) < 1e-6
    ways = camera.centre_in_world - points
    for foot_x, foot_y, radius in balls:
        inwards = [foot_x, foot_y, radius] - points
        along = np.clip((inwards * ways).sum(1) / (ways**2).sum(1), 0, 1)
        seen &= np.linalg.norm(inwards - along[:, None] * ways, axis=1) > radius - 1e-6
    return np.flatnonzero(seen)


def _plain_top(balls: list[Ball], sheet: float) -> np.ndarray:
    """(640, 640, 3) float32: white, or brown around a sheet, and darker around the feet of the balls."""
    y, x = (np.mgrid[:640, :640] / 639 - 0.5) * 8.0
    light = np.ones((640, 640))
    for foot_x, foot_y, radius in balls:
        light -= 0.45 * np.exp(-((x - foot_x) ** 2 + (y - foot_y) ** 2) / (0.9 * radius) ** 2)
    white = np.maximum(np.abs(x), np.abs(y)) < (sheet or np.inf)
    return np.where(white[..., None], 220.0 * light[..., None], light[..., None] * BROWN).astype(np.float32)


def _lay_leaflet(top: np.ndarray, leaflet: Ball) -> None:
    """Print it on the (640, 640, 3) picture of the table's top."""
    middle_x, middle_y, half = leaflet
    left, right, high, low = (round((at / 8.0 + 0.5) * 639) for at in (middle_x - half, middle_x + half, middle_y - half, middle_y + half))
    print_ = np.random.default_rng(1).integers(20, 236, (12, 12, 3), np.uint8)
    top[high:low, left:right] = cv2.resize(print_, (right - left, low - high), interpolation=cv2.INTER_NEAREST)


def _drawn(camera: Camera, balls: list[Ball], print_: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) picture, and (30 B, 3) points of the balls that it shows."""
    rays = look_along(camera)
    origin = camera.centre_in_world
    down = np.where(rays[..., 2] < -1e-6, -origin[2] / rays[..., 2], np.inf)
    with np.errstate(invalid="ignore"):
        ground = np.where(np.isfinite(down)[..., None], origin + down[..., None] * rays, 0.0)
    texel = ((ground[..., :2] / 8.0 + 0.5) * 639).astype(np.float32)
    image = cv2.remap(print_, texel[..., 0], texel[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    image[~np.isfinite(down)] = 128
    points = [np.zeros((0, 3))]
    for foot_x, foot_y, radius in balls:
        middle = np.array([foot_x, foot_y, radius])
        away = origin - middle
        b, c, n = rays @ away, away @ away - radius**2, (rays**2).sum(-1)
        hit = b**2 > n * c
        depth = (-b - np.sqrt(np.maximum(b**2 - n * c, 0))) / n
        normal = (origin + depth[..., None] * rays - middle) / radius
        image[hit] = (np.array([230, 140, 20]) * (0.75 + 0.25 * normal[..., 2:]) * (0.9 + 0.1 * np.sin(9 * normal[..., :1])))[hit]
        chosen = np.argwhere(hit)[rng.choice(int(hit.sum()), 30)] if hit.any() else np.zeros((0, 2), int)
        points.append((origin + depth[..., None] * rays)[tuple(chosen.T)])
    return np.clip(image, 0, 255).astype(np.uint8), np.concatenate(points)
