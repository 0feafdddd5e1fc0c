"""Faces that are no triangles, or that occur twice; and vertices that only they use."""

import numpy as np


def find_triangles(faces: np.ndarray) -> np.ndarray:
    """(F,) bool: faces with three different vertices."""
    return (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])


def drop_repeated_faces(faces: np.ndarray) -> np.ndarray:
    """The faces in their order, each set of three vertices once."""
    _, first = np.unique(np.sort(faces, 1), axis=0, return_index=True)
    return faces[np.sort(first)]
