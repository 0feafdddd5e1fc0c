"""Leave out what lies flat on a plain table, such as a sheet of paper or a printed board on which the object stands.

Its colours are not the table's, so masks by colour have it, and the mesh would stand on a slab. But seen place by place, as a printed
ground, all views agree on it. That it is flat is told by its outline: where it ends on the ground, the masks end, too. What rises hides the
ground behind it from every side.
"""

from typing import Protocol

import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.geometry.support_plane import count_showing_masks
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.segment.ground import CELL_DISTANCES
from zeroshop_steps.segment.led_by_points import Found

REACH_DISTANCES = 0.6  # of the ground that is looked at
FOOT_SHARE = 0.5  # of the masks that show a place of the ground, where the object or a sheet covers it
RIM_CELLS = (2, 3)  # from a foot to its surroundings: masks end up to a pixel or two off, and a cell is about a pixel
LEAST_VIEWS = 3  # that have a place in the image
FLAT_SHARE = 0.15
"""Of the masks, the share that shows the places right beside the foot, in the mean: 0.00 of a printed sheet, 0.33 to 0.48 of 24 other
things, as low as scissors and a clay brick, 0.26 of a marker pen in ten views. What is thinner than 3 mm, from half a metre, is flat."""

Prior = list[np.ndarray] | None


class FindOn(Protocol):
    """Finds masks of what stands on a plane."""

    def __call__(self, support: SceneSupport, fitted: bool, by_color: bool = True) -> tuple[Found, Prior]:
        """What is found, and the log odds that led to it; raises StepError. `by_color`: whether the colour of a plain table counts."""
        ...


def lies_flat(views: list[View], masks: list[np.ndarray], support: SceneSupport) -> bool:
    """Whether what (H, W) bool masks show does not rise from its plane along its rim; False where it covers no place of the plane."""
    count = round(2 * REACH_DISTANCES / CELL_DISTANCES)
    places = (np.arange(count) + 0.5 - count / 2) * CELL_DISTANCES * support.distance
    across, along = support.axes()
    cells = support.foot + places[:, None, None] * across + places[None, :, None] * along
    shown, held = count_showing_masks(cells.reshape(-1, 3), [view.camera for view in views], masks)
    share = np.where(held >= LEAST_VIEWS, shown / np.maximum(held, 1), 0.0).reshape(count, count)
    foot = _take_nearest(share > FOOT_SHARE)
    if not foot.any():
        return False
    away = ndimage.distance_transform_edt(~ndimage.binary_fill_holes(foot))
    beside = (away > RIM_CELLS[0]) & (away <= RIM_CELLS[1])
    return bool(beside.any() and share[beside].mean() < FLAT_SHARE)


def find_beside_flat(views: list[View], found: Found, support: SceneSupport, fitted: bool, find_on: FindOn) -> tuple[Found, Prior] | None:
    """What stands on the flat thing that `found` has; None where it has none, or nothing stands on it.

    Args:
        views: all of them.
        found: by the colour of a plain table.
        support, fitted: where it was looked for.
        find_on: finds masks.
    """
    if not lies_flat(views, found.masks, found.support):
        return None
    print("what was found lies flat on the ground: the ground is told place by place")
    try:
        other, prior = find_on(support, fitted, by_color=False)
    except StepError as error:
        print(f"nothing is told from it so: {error}")
    else:
        if not lies_flat(views, other.masks, other.support):
            warn("what lies flat under the object, such as a sheet of paper, is left out of the masks; look at contact_sheet.png")
            return other, prior
    warn(
        "the masks show something flat: is it a sheet on which the object stands, take it away, or give masks of the object alone; look at"
        " contact_sheet.png"
    )
    return None


def _take_nearest(foot: np.ndarray) -> np.ndarray:
    """(N, N) bool: the connected part of a foot that is nearest to the middle."""
    parts, count = ndimage.label(foot)
    if not count:
        return foot
    rows, columns = np.nonzero(foot)
    nearest = np.hypot(rows - len(foot) / 2, columns - len(foot) / 2).argmin()
    part: np.ndarray = parts == parts[rows[nearest], columns[nearest]]
    return part
