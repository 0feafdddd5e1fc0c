"""A printed box before a wall, seen by a camera with depth."""

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.synthetic.scenes.distractors import make_distractor

INTRINSICS = np.array([[500.0, 0, 79.5], [0, 500.0, 59.5], [0, 0, 1]])
"""BOP's K: the middle of the first pixel is at (0, 0)."""


def make_box() -> ObjectModel:
    """A box with another print on each side."""
    rng = np.random.default_rng(5)
    mesh = next(mesh for mesh in iter(lambda: make_distractor(rng), None) if len(mesh.faces) == 12)
    return ObjectModel(1, mesh, float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))), np.eye(4)[None], {})


def view(model: ObjectModel, seed: int, hidden: bool):
    """(pose, photo, depth, mask) of the box, turned anyhow, with 1 mm of noise."""
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(rng.normal(size=4)).as_matrix(), [8, -5, 700]
    return pose, *taken(model, pose, rng, hidden)


def taken(model: ObjectModel, pose: np.ndarray, rng: np.random.Generator, hidden: bool = False):
    """(photo, depth, mask) of the box at this pose; `hidden`: something nearer is before its left half."""
    camera = Camera("", 160, 120, INTRINSICS + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]), pose)
    renderer = MeshRenderer(model.mesh)
    depth = renderer.cast_rays(camera).depth
    mask = depth > 0
    if hidden:
        mask[:, : int(np.median(np.nonzero(mask)[1]))] = False
    measured = np.where(depth > 0, depth, 950.0) + rng.normal(0, 1, depth.shape)
    measured[(depth > 0) & ~mask] = 500.0
    return renderer.render_color(camera, (0, 0, 0)), measured.astype(np.float32), mask
