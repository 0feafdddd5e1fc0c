"""Pose hypotheses: the model turned every way, at the place that the mask and the depth tell."""

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

LEAST_VIEWS = 40  # directions at least: the corners of a sphere of triangles; an icosahedron divided once has 42
SAME_TURN_DEG = 30.0  # rotations that differ by less, up to a symmetry of the object, are the same


def make_rotations(symmetries: np.ndarray) -> np.ndarray:
    """(N, 3, 3) camera_from_model rotations from all sides, without those that a symmetry makes alike.

    Args:
        symmetries: (S, 4, 4) model_from_model, the identity among them.
    """
    turns = Rotation.from_euler("z", -np.arange(0.0, 360.0, 60.0)[:, None], degrees=True).as_matrix()
    all_of_them = (turns[None] @ _make_views()[:, None]).reshape(-1, 3, 3)
    return all_of_them[_find_different(all_of_them, symmetries[:, :3, :3])]


def _make_views() -> np.ndarray:
    """(V, 3, 3) camera_from_model of cameras all around that look at the model, upright where that is defined."""
    divisions = 1
    while len(corners := np.asarray(trimesh.creation.icosphere(divisions, 1.0).vertices)) < LEAST_VIEWS:
        divisions += 1
    forward = -corners / np.linalg.norm(corners, axis=1, keepdims=True)
    right = np.cross([0.0, 0.0, 1.0], forward)
    right[~right.any(1)] = [1.0, 0.0, 0.0]
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def _find_different(rotations: np.ndarray, symmetries: np.ndarray) -> list[int]:
    """Indices of the rotations, the first first, without those that differ by less than SAME_TURN_DEG from an earlier one."""
    least_trace = 1.0 + 2.0 * np.cos(np.radians(SAME_TURN_DEG))
    kept: list[int] = []
    for index, rotation in enumerate(rotations):
        alike = rotation @ symmetries  # (S, 3, 3)
        traces = np.einsum("kij,sij->ks", rotations[kept], alike) if kept else np.zeros((0, 1))
        if not (traces > least_trace).any():
            kept.append(index)
    return kept


def estimate_centre(mask: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray) -> np.ndarray | None:
    """(3,) mm, where the object's centre may be: in the middle of the mask's box, at its median depth. None where it has no depth.

    Args:
        mask: (H, W) bool.
        depth_mm: (H, W) measured, 0 where there is none.
        intrinsics: (3, 3) BOP's K.
    """
    measured = depth_mm[mask & (depth_mm > 0)]
    if not len(measured):
        return None
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    middle = [(columns[0] + columns[-1]) / 2, (rows[0] + rows[-1]) / 2, 1.0]
    return np.linalg.inv(intrinsics) @ middle * float(np.median(measured))
