"""A can whose two sides look alike, and differ in detail only."""

import cv2
import numpy as np
import trimesh

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh


def can_with_two_faces() -> Mesh:
    """A can with the same large shapes on both sides, and other small ones beside them."""
    rng = np.random.default_rng(3)
    coarse = cv2.resize(rng.integers(60, 200, (6, 8, 3), dtype=np.uint8), (400, 300), interpolation=cv2.INTER_CUBIC)
    fine = cv2.resize(rng.integers(0, 56, (75, 200, 3), dtype=np.uint8), (800, 300), interpolation=cv2.INTER_NEAREST)
    solid = trimesh.creation.cylinder(35, 100, sections=96)
    corners = np.asarray(solid.vertices)[solid.faces]
    turns = np.arctan2(corners[..., 1], corners[..., 0]) / (2 * np.pi)
    turns -= np.round(turns - turns[:, :1])  # the corners of a face on one side of the seam
    uv = np.stack([np.clip(turns + 0.5, 0, 1), corners[..., 2] / 100 + 0.5], -1)
    texture = cv2.add(np.hstack([coarse, coarse]), fine)
    return Mesh(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3), None, uv.reshape(-1, 2), texture)
