"""Symmetries of a model from models_info.json: transforms after which it looks the same."""

import numpy as np
from scipy.spatial.transform import Rotation

STEP = 0.01  # in diameters, by BOP: how far the rim of a continuously symmetric object moves between two sampled rotations


def list_symmetry_transforms(info: dict, step: float = STEP) -> np.ndarray:
    """(S, 4, 4) transforms model_from_model in mm, the identity first: each discrete one with each continuous one.

    Rotations about an axis are sampled ceil(pi / step) times, so that no point on a circle of the model's diameter moves by more than
    `step` diameters from one to the next (BOP Challenge 2019: one hundredth). Several axes are sampled one by one.
    """
    discrete = [np.eye(4)] + [np.reshape(matrix, (4, 4)).astype(float) for matrix in info.get("symmetries_discrete", [])]
    turns = [_sample_turns(entry, step) for entry in info.get("symmetries_continuous", [])]
    if not turns:
        return np.stack(discrete)
    continuous = np.concatenate(turns)
    return np.concatenate([continuous @ matrix for matrix in discrete])


def _sample_turns(entry: dict, step: float) -> np.ndarray:
    """(N, 4, 4) rotations about the axis through `offset`, the identity first."""
    axis, offset = np.asarray(entry["axis"], float), np.asarray(entry["offset"], float)
    count = int(np.ceil(np.pi / step))
    angles = np.arange(count) * (2.0 * np.pi / count)
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, :3, :3] = Rotation.from_rotvec(angles[:, None] * axis / np.linalg.norm(axis)).as_matrix()
    transforms[:, :3, 3] = offset - transforms[:, :3, :3] @ offset
    return transforms
