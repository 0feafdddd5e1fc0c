"""Check that the object did not move: the first half of the views must find it where the second half does.

Where they do not, one half may have found another thing, or a part. Sparse points tell: those of a thing that stays tie the views of both
halves, those of one that moved are seen in one half alone.
"""

import numpy as np

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.object_selection import COARSE_VOXELS, REACH_DISTANCES, ObjectSelection, select_object
from zeroshop_steps.segment.plain_ground import find_risen_points
from zeroshop_steps.segment.risen_points import RisenPoints

LEAST_VIEWS = 12  # with fewer, half of the views cannot tell an object from its surroundings
LEAST_OVERLAP = 0.5
"""Share of the smaller footprint that lies in the larger one: nearly all of it for an object that stays, even with few directions."""


class ObjectMoved(StepError):
    """The halves of the photos show the object in different places."""


def check_not_moved(
    support: SceneSupport, cameras: list[Camera], evidence: list[np.ndarray], model: SparseModel, risen: np.ndarray | None = None
) -> None:
    """Raise ObjectMoved where the second half of the views shows the object at another place.

    Args:
        model: the sparse model of these views.
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
    apart = len(first & second) < LEAST_OVERLAP * min(len(first), len(second))
    if apart and not all(_stays(footprint, support, model) for footprint in (first, second)):
        raise ObjectMoved(
            f"the object moved during the film: until {cameras[middle - 1].name} it stands elsewhere than from {cameras[middle].name} on; "
            "film it again without touching it or the ground, or register it by itself (scene video_segmented)"
        )


def _find_footprint(support: SceneSupport, selection: ObjectSelection) -> set[tuple[int, int]]:
    """The cells of the plane that the object stands on or overhangs."""
    return set(map(tuple, np.unique(_find_cells(support, selection.grid.centres(np.argwhere(selection.cluster))), axis=0).tolist()))


def _stays(footprint: set[tuple[int, int]], support: SceneSupport, model: SparseModel) -> bool:
    """Whether the points above a part of the plane tie nearly all views to each other."""
    risen = find_risen_points(model.points, support)
    above = [cell in footprint for cell in map(tuple, _find_cells(support, risen).tolist())]
    return RisenPoints(risen[above], support).tie(model)


def _find_cells(support: SceneSupport, points: np.ndarray) -> np.ndarray:
    """(P, 2) int: the cells of the plane below (P, 3) points."""
    side = 2 * REACH_DISTANCES * support.distance / COARSE_VOXELS
    return np.floor((points - support.foot) @ support.axes().T / side).astype(int)
