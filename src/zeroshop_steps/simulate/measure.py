"""How right a sighting is."""

import numpy as np

from zeroshop_steps.bop.scoring.pose_error import ModelPoints, mssd

SEGMENTED_IOU = 0.5
"""Of a mask with the true visible one, from which the object counts as segmented."""


def pose_error_mm(
    camera_from_mesh: np.ndarray, truth_from_mesh: np.ndarray, camera_from_model: np.ndarray, vertices: np.ndarray, symmetries: np.ndarray
) -> float:
    """MSSD of a pose of the robot's mesh, applied to the true model; mm.

    Args:
        camera_from_mesh: (4, 4) the estimate.
        truth_from_mesh: (4, 4) similarity from the robot's mesh to the true model.
        camera_from_model: (4, 4) the true pose of the true model.
        vertices: (V, 3) of the true model.
        symmetries: (S, 4, 4) of the true model.
    """
    estimated = camera_from_mesh @ np.linalg.inv(truth_from_mesh)
    return float(mssd(estimated[None], camera_from_model[None], ModelPoints.from_vertices(vertices), symmetries)[0])
