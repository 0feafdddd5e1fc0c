"""What a structured-light camera measures of exact depth: whole steps of disparity, ragged edges, shadows and holes.

Disparity noise and the shifted look-up as Barron and Malik (2013) and Handa et al. (ICL-NUIM, 2014) model a Kinect; shadows by
rays to the projector; steep surfaces give no return (Khoshelham and Elberink 2012).
"""

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.observation.visibility import GRAZING_COSINE
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.synthetic.rendering.shading import make_camera_rays

DISPARITY_STEPS_MM = 351_300.0  # eight times focal length times baseline: depth of one step
STEP_DEVIATION = 1 / 6  # standard deviation of the disparity, in steps (Barron and Malik 2013)
SHIFT_DEVIATION_PX = 0.5  # of the place that a pixel's depth is looked up at (the same)
PROJECTOR_MM = np.array([75.0, 0.0, 0.0])  # from the camera, along its axes, as in a Kinect
LOST_SHARE = 0.002  # of all pixels, at random
FARTHEST_MM = 3500.0  # that is measured


def take_depth_image(scene: o3d.t.geometry.RaycastingScene, camera: Camera, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(height, width) exact depth of a scene in mm, 0 where there is nothing, and what is measured of it, 0 likewise."""
    pixels = np.stack(np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5), -1)
    rays = make_camera_rays(pixels.reshape(-1, 2), camera.intrinsics, np.linalg.inv(camera.camera_from_world))
    rays = rays.reshape(camera.height_px, camera.width_px, 6)
    hits = scene.cast_rays(o3d.core.Tensor(rays))
    depth, normals = hits["t_hit"].numpy(), hits["primitive_normals"].numpy()
    depth = np.where(np.isfinite(depth), depth, 0.0)
    return depth, simulate_depth(depth, normals, rays, scene, camera.camera_from_world, rng)


def simulate_depth(
    depth_mm: np.ndarray, normals: np.ndarray, rays: np.ndarray, scene: o3d.t.geometry.RaycastingScene, camera_from_world: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """(height, width) float32 mm, 0 where nothing is measured.

    Args:
        depth_mm: (height, width) exact depth along the optical axis, 0 where there is nothing.
        normals: (height, width, 3) of the surface, world frame.
        rays: (height, width, 6) of the pixels, world frame, directions of unit depth.
        scene: what the projector's light may be blocked by.
        camera_from_world: (4, 4).
        rng: of the noise.
    """
    height, width = depth_mm.shape
    directions = rays[..., 3:] / np.linalg.norm(rays[..., 3:], axis=2, keepdims=True)
    grazing = np.abs(np.einsum("hwi,hwi->hw", normals, directions)) < GRAZING_COSINE
    points = rays[..., :3] + depth_mm[..., None] * rays[..., 3:]
    projector = camera_from_world[:3, :3].T @ (PROJECTOR_MM - camera_from_world[:3, 3])
    to_points = np.concatenate([np.broadcast_to(projector, points.shape), points - projector], 2).astype(np.float32)
    shadow = scene.test_occlusions(o3d.core.Tensor(to_points), 0.0, 0.995).numpy()
    good = np.where(grazing | shadow | (depth_mm > FARTHEST_MM), 0.0, depth_mm)
    shift = np.rint(rng.normal(0.0, SHIFT_DEVIATION_PX, (2, height, width))).astype(int)
    rows = np.clip(np.arange(height)[:, None] + shift[0], 0, height - 1)
    columns = np.clip(np.arange(width) + shift[1], 0, width - 1)
    seen = good[rows, columns]
    steps = np.floor(DISPARITY_STEPS_MM / np.maximum(seen, 1.0) + rng.normal(0.0, STEP_DEVIATION, seen.shape) + 0.5)
    lost = (seen == 0) | (rng.uniform(size=seen.shape) < LOST_SHARE)
    return np.where(lost, 0.0, DISPARITY_STEPS_MM / np.maximum(steps, 1.0)).astype(np.float32)
