"""Symmetries of a model from models_info.json: transforms after which it looks the same."""

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.runtime.errors import StepError

UNIT_TOLERANCE = 1e-3
"""By which an axis' length may differ from 1, and R R^T of a discrete symmetry from the identity: files round their numbers."""
STEP = 0.01  # in diameters, by BOP: how far the rim of a continuously symmetric object moves between two sampled rotations


def check_symmetries(info: dict, where: str) -> None:
    """Check an object's entry of models_info.json; `where` names the object in messages.

    Raises:
        StepError: a continuous symmetry without a unit axis, or a discrete one that is no rotation with a translation.
    """
    for entry in info.get("symmetries_continuous", []):
        axis, offset = np.asarray(entry["axis"], float), np.asarray(entry["offset"], float)
        if not (np.isfinite(axis).all() and np.isfinite(offset).all() and abs(np.linalg.norm(axis) - 1) < UNIT_TOLERANCE):
            raise StepError(
                f"{where}: symmetries_continuous has the axis {axis.tolist()} and the offset {offset.tolist()};"
                " expected an axis of length 1 and an offset in mm"
            )
    for number, values in enumerate(info.get("symmetries_discrete", [])):
        matrix = np.reshape(np.asarray(values, float), (4, 4))
        rotation = matrix[:3, :3]
        rigid = np.isfinite(matrix).all() and np.abs(rotation @ rotation.T - np.eye(3)).max() < UNIT_TOLERANCE
        if not (rigid and np.linalg.det(rotation) > 0 and np.array_equal(matrix[3], [0, 0, 0, 1])):
            raise StepError(
                f"{where}: entry {number} of symmetries_discrete is no rigid motion; expected 16 numbers, row by row: a rotation, a"
                " translation in mm, and 0 0 0 1"
            )


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
