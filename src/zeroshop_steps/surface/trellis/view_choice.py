"""Which two photos the generator sees: from opposite sides, about 45 degrees above the object."""

from collections.abc import Sequence

import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.support.ground_plane import estimate_up_from_roll

ELEVATION_DEG, APART_DEG = 45.0, 180.0


def choose_opposite_views(views: Sequence[View], centre: np.ndarray) -> tuple[int, int]:
    """Indices of the two, the earlier first.

    Args:
        views: two or more.
        centre: (3,) of the object, in the frame of the cameras.
    """
    up, _ = estimate_up_from_roll(list(views))
    outwards = np.array([view.camera.centre_in_world - centre for view in views])
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    elevation = np.degrees(np.arcsin(np.clip(outwards @ up, -1.0, 1.0)))
    level = outwards - (outwards @ up)[:, None] * up
    level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-9)
    apart = np.degrees(np.arccos(np.clip(level @ level.T, -1.0, 1.0)))
    tilt = (elevation - ELEVATION_DEG) ** 2
    cost = tilt[:, None] + tilt[None] + (apart - APART_DEG) ** 2
    cost[np.tril_indices(len(views))] = np.inf
    first, second = np.unravel_index(np.round(cost, 6).argmin(), cost.shape)
    return int(first), int(second)
