"""Check that the object did not move: the first half of the views must find it where the second half does."""

import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.object_selection import COARSE_VOXELS, REACH_DISTANCES, ObjectSelection, select_object

LEAST_VIEWS = 12  # with fewer, half of the views cannot tell an object from its surroundings
LEAST_OVERLAP = 0.5
"""Share of the smaller footprint that lies in the larger one: nearly all of it for an object that stays, even with few directions."""


def check_not_moved(support: SceneSupport, cameras: list[Camera], evidence: list[np.ndarray], risen: np.ndarray | None = None) -> None:
    """Raise StepError where the second half of the views shows the object at another place.

    Args:
        support: the plane that it stands on.
        cameras: of all views, in the order in which they were taken.
        evidence, risen: as for `select_object`.
    """
    if len(cameras) < LEAST_VIEWS:
        return
    middle = len(cameras) // 2
    try:
        halves = [select_object(support, cameras[part], evidence[part], risen) for part in (slice(middle), slice(middle, None))]
    except StepError:
        return  # half of the views are too few to find the object; all of them may do
    first, second = (_find_footprint(support, selection) for selection in halves)
    if len(first & second) < LEAST_OVERLAP * min(len(first), len(second)):
        raise StepError(
            f"the object moved during the film: until {cameras[middle - 1].name} it stands elsewhere than from {cameras[middle].name} on; "
            "film it again without touching it or the ground, or register it by itself (scene video_segmented)"
        )


def _find_footprint(support: SceneSupport, selection: ObjectSelection) -> set[tuple[int, int]]:
    """The cells of the plane that the object stands on or overhangs."""
    side = 2 * REACH_DISTANCES * support.distance / COARSE_VOXELS
    cells = np.floor((selection.grid.centres(np.argwhere(selection.cluster)) - support.foot) @ support.axes().T / side).astype(int)
    return set(map(tuple, np.unique(cells, axis=0).tolist()))
