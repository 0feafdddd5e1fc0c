"""Checks of the poses in BOP's files: proper rotations, finite millimetres."""

from typing import Protocol

import numpy as np

from zeroshop_steps.runtime.errors import StepError

ROTATION_TOLERANCE = 1e-2  # by which R R^T may differ from the identity: published files round to few digits
NEAREST_MM = 10.0  # median distance of the objects below which translations are taken for metres


class Names(Protocol):
    """Names of places in a file by their index."""

    def __getitem__(self, index: int, /) -> str: ...


def check_rotations(rotations: np.ndarray, where: Names, path: object) -> None:
    """Raise StepError if one of (N, 3, 3) matrices is no rotation; `where` names the N places in the file `path`."""
    finite = np.isfinite(rotations).all((1, 2))
    safe = np.where(finite[:, None, None], rotations, 0.0)
    off = np.abs(safe @ safe.transpose(0, 2, 1) - np.eye(3)).max((1, 2), initial=0.0)
    wrong = np.flatnonzero(~finite | (off > ROTATION_TOLERANCE) | (np.linalg.det(safe) < 0))
    if len(wrong):
        first = wrong[0]
        fault = (
            "holds numbers that are not finite"
            if not finite[first]
            else "mirrors"
            if off[first] <= ROTATION_TOLERANCE
            else "is no rotation"
        )
        raise StepError(
            f"{path}, {where[first]}: R {fault} ({len(wrong)} of {len(rotations)} poses are wrong);"
            " expected 9 numbers, row by row, with R R^T = 1 and det R = 1"
        )


def check_translations(translations_mm: np.ndarray, where: Names, path: object) -> None:
    """Raise StepError if one of (N, 3) translations is not finite, or if most are so short that they must be metres."""
    wrong = np.flatnonzero(~np.isfinite(translations_mm).all(1))
    if len(wrong):
        raise StepError(f"{path}, {where[wrong[0]]}: t holds numbers that are not finite ({len(wrong)} such poses); expected millimetres")
    if len(translations_mm) and np.median(translations_mm[:, 2]) <= 0:
        raise StepError(
            f"{path}: most objects are behind the camera (t_z is {np.median(translations_mm[:, 2]):.4g} in the median);"
            " expected camera_from_model with x right, y down and z forward. Is it inverted, or with OpenGL's axes?"
        )
    if len(translations_mm) and np.median(np.linalg.norm(translations_mm, axis=1)) < NEAREST_MM:
        raise StepError(
            f"{path}: objects are {np.median(np.linalg.norm(translations_mm, axis=1)):.3g} from the camera in the median;"
            " t looks like metres, millimetres are expected. Multiply it by 1000."
        )


def make_transform(rotation: np.ndarray, translation_mm: np.ndarray) -> np.ndarray:
    """(4, 4) transform of a rotation and a translation; (N, 4, 4) of (N, 3, 3) and (N, 3)."""
    transform = np.zeros((*rotation.shape[:-2], 4, 4))
    transform[..., :3, :3], transform[..., :3, 3], transform[..., 3, 3] = rotation, translation_mm, 1.0
    return transform
