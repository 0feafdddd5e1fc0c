"""A small ball with a smooth pattern, drawn without the renderers under test."""

import numpy as np
import torch

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.surface.mvs.free_space import HullDistanceField
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.training.initialization import FreeSpace, Initialization

SIZE_PX, FOCAL_PX, RADIUS = 64, 90.0, 0.6


def look_at(centre: np.ndarray) -> np.ndarray:
    forward = -centre / np.linalg.norm(centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    return pose


def ball_views(size_px: int = SIZE_PX, fineness: float = 1.0) -> tuple[list[TrainingView], list[np.ndarray]]:
    """Two rings of ten views of the ball, and their exact depths."""
    pairs = [ball_view(azimuth, elevation, size_px, fineness) for elevation in (-25.0, 25.0) for azimuth in range(0, 360, 36)]
    return [view for view, _ in pairs], [depth for _, depth in pairs]


def ball_view(azimuth_deg: float, elevation_deg: float, size_px: int, fineness: float) -> tuple[TrainingView, np.ndarray]:
    """A view of the ball and its exact depth (0 outside); fineness multiplies the pattern's frequencies."""
    focal_px = FOCAL_PX * size_px / SIZE_PX
    a, e = np.radians([azimuth_deg, elevation_deg])
    centre = 2.5 * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    k = np.array([[focal_px, 0, size_px / 2], [0, focal_px, size_px / 2], [0, 0, 1]])
    camera = Camera(f"{azimuth_deg}_{elevation_deg}.png", size_px, size_px, k, look_at(centre))
    y, x = np.mgrid[:size_px, :size_px] + 0.5
    rays = np.stack([(x - k[0, 2]) / focal_px, (y - k[1, 2]) / focal_px, np.ones_like(x)], -1) @ camera.camera_from_world[:3, :3]
    b, c, n = rays @ centre, centre @ centre - RADIUS**2, (rays**2).sum(-1)
    inside = b**2 - n * c
    depth = np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / n, 0.0)
    points = centre + depth[..., None] * rays
    smooth = 0.5 + 0.4 * np.sin(9.0 * fineness * points) * np.cos(7.0 * fineness * points[..., [1, 2, 0]])
    mask = (inside > 0).astype(np.float32)
    color = (smooth * mask[..., None]).astype(np.float32).transpose(2, 0, 1).copy()
    active = np.ones((size_px, size_px), bool)
    return TrainingView(camera, torch.from_numpy(color), torch.from_numpy(mask), torch.from_numpy(active), np.ones((4, 4), bool)), depth


def ball_initialization(views: list[TrainingView]) -> Initialization:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(600, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cameras, masks = [view.camera for view in views], [view.mask.numpy() > 0 for view in views]
    volume = HullDistanceField.from_hull(VisualHull.carve(cameras, masks, 1.0, 48, misses_allowed=1))
    nothing = {camera.name: np.zeros((0, 2)) for camera in cameras}
    none = {camera.name: np.zeros(0) for camera in cameras}
    points = normals * RADIUS * rng.uniform(0.9, 1.0, (600, 1))
    return Initialization(points, np.full((600, 3), 0.5), normals, FreeSpace(cameras, masks, volume), nothing, none, none)
