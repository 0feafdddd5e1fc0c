"""Leave out what lies flat on a plain table, such as a sheet of paper or a printed board on which the object stands.

Its colours are not the table's, so masks by colour have it, and the mesh would stand on a slab. That it is flat is told by its outline:
where it ends on the ground, the masks end, too. What rises hides the ground behind it from every side. Then the ground is seen place by
place, as a printed one: all views agree on the sheet. Where they agree on a low thing of one colour, too, or on a side of it, the sheet is
a plain ground. So it is on a turntable: shadows stay while the plate turns below them, and place by place, they are no ground.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.geometry.support_plane import count_showing_masks
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.segment.ground import MIN_WITNESSES, GroundPicture, lay_cells
from zeroshop_steps.segment.led_by_points import MOST_DROPPED, Found
from zeroshop_steps.segment.own_outlines import OUTGROWN_SHARE, cut_around
from zeroshop_steps.segment.plain_ground import PlainGround, fit_plain_ground

FOOT_SHARE = 0.5  # of the masks that show a place of the ground, where the object or a sheet covers it
RIM_CELLS = (2, 3)  # from a foot to its surroundings: masks end up to a pixel or two off, and a cell is about a pixel
FLAT_SHARE = 0.15
"""Of the masks, the share that shows the places right beside the foot, in the mean: 0.00 and 0.07 of two printed sheets, 0.18 of a flat
stone that was seen from above, 0.26 to 0.48 of 33 other things, as low as scissors and a clay brick. What is thinner than 3 mm, from half a
metre, is flat."""
WIDE_CELLS, FLAT_DROP = 60, 0.65
"""A tall thing on a sheet hides the places around it from low views. So of what is so wide, the drop of that share across the rim counts:
0.81 of a sheet with a pineapple on it, at most 0.51 of seven things that are as wide."""

Prior = list[np.ndarray] | None


class FindOn(Protocol):
    """Finds masks of what stands on a plane."""

    def __call__(self, support: SceneSupport, fitted: bool, by_color: bool = True, sheet: np.ndarray | None = None) -> tuple[Found, Prior]:
        """What is found, and the log odds that led to it; raises StepError.

        `by_color`: whether the colour of a plain table counts; `sheet`: the cells of the ground's picture that a plain sheet covers.
        """
        ...


@dataclass(frozen=True)
class SheetGround:
    """A plain table with a plain sheet on it.

    Attributes:
        picture: of the ground.
        table, sheet: their colours.
        cells: (N, N) bool: of the picture, those that the sheet covers.
    """

    picture: GroundPicture
    table: PlainGround
    sheet: PlainGround
    cells: np.ndarray

    def evidence(self, camera: Camera, image: np.ndarray) -> np.ndarray:
        """As `PlainGround.evidence`, by the colour of either; along the sheet's edge, what either takes for ground is ground."""
        covered = self.picture.see_cells(self.cells, camera)
        window = np.ones((2 * RIM_CELLS[0] + 1,) * 2, np.uint8)
        on_table, on_sheet = cv2.erode(covered, window) < 1, cv2.dilate(covered, window) > 0
        by_table, by_sheet = (ground.evidence(camera, image) for ground in (self.table, self.sheet))
        odds = np.where(on_sheet, by_sheet, by_table)
        return np.where(on_table & on_sheet, np.minimum(by_table, by_sheet), odds).astype(np.float32)


def add_sheet(table: PlainGround, picture: GroundPicture, cells: np.ndarray, risen: np.ndarray) -> SheetGround:
    """A table with a sheet on it, whose colour is learned where it covers cells of the picture; raises StepError where it is not plain.

    Args:
        table: its colour, and `picture`: of the ground.
        cells: (N, N) bool, covered by the sheet.
        risen: (P, 3) sparse points above the ground.
    """
    sheet = fit_plain_ground(replace(picture, known=picture.known & cells), risen)
    if sheet is None:
        raise StepError("what lies flat on the ground has no one colour")
    return SheetGround(picture, table, sheet, cells)


def find_flat_foot(views: list[View], masks: list[np.ndarray], support: SceneSupport) -> np.ndarray | None:
    """(N, N) bool: the cells of the ground's picture that are covered by what (H, W) bool masks show, if it does not rise along its rim.

    None where it rises, or covers nothing.
    """
    count, world_from_cell = lay_cells(support)
    y, x = np.mgrid[:count, :count].reshape(2, -1)
    cells = np.stack([x, y, np.ones_like(x)], axis=1) @ world_from_cell[:3].T
    shown, held = count_showing_masks(cells, [view.camera for view in views], masks)
    share = np.where(held >= MIN_WITNESSES, shown / np.maximum(held, 1), 0.0).reshape(count, count)
    foot = ndimage.binary_fill_holes(_take_nearest(share > FOOT_SHARE))
    if not foot.any():
        return None
    inside, beside = (share[_take_rim(part)] for part in (foot, ~foot))
    if not len(beside):
        return None
    wide = len(inside) and foot.sum() > WIDE_CELLS**2 and inside.mean() - beside.mean() > FLAT_DROP
    return foot if wide or beside.mean() < FLAT_SHARE else None


def _take_rim(part: np.ndarray) -> np.ndarray:
    """(N, N) bool: the cells of a part of the ground that lie `RIM_CELLS` within its edge."""
    depth = ndimage.distance_transform_edt(part)
    rim: np.ndarray = (depth > RIM_CELLS[0]) & (depth <= RIM_CELLS[1])
    return rim


def find_beside_flat(views: list[View], found: Found, find_on: FindOn) -> tuple[Found, Prior, bool] | None:
    """What stands on the flat thing that `found` has, and whether its colours told it; None where it has none, or nothing stands on it.

    Args:
        views: all of them.
        found: by the colour of a plain table.
        find_on: finds masks.
    """
    sheet = find_flat_foot(views, found.masks, found.support)
    if sheet is None:
        return None
    kept = {name: found.record[name] for name in ("plane_from", "plane_inliers")}
    standing = [
        (replace(other, record=other.record | kept), prior, by_color)
        for other, prior, by_color in _find_on_sheet(sheet, found.support, find_on)
        if find_flat_foot(views, other.masks, other.support) is None
    ]
    if standing:
        warn("what lies flat under the object, such as a sheet of paper, is left out of the masks; look at contact_sheet.png")
        return _choose_standing(views, standing)
    warn(
        "the masks show something flat: if it is a sheet on which the object stands, take it away, or give masks of the object alone; look"
        " at contact_sheet.png"
    )
    return None


def _choose_standing(views: list[View], standing: list[tuple[Found, Prior, bool]]) -> tuple[Found, Prior, bool]:
    """Of what stands on a flat thing, told place by place and by its colour: the masks that agree best with each other.

    Masks that all lack a side agree, too. But the photos' own colours go on beyond them.
    """
    if len(standing) == 1:
        return standing[0]
    most_dropped = MOST_DROPPED * len(views)
    by_agreement = sorted(standing, key=lambda each: (len(each[0].record["dropped"]) > most_dropped, each[0].record["median_disagreement"]))
    return next((each for each in by_agreement if cut_around(views, each[0].masks)[1] <= OUTGROWN_SHARE), standing[-1])


def _find_on_sheet(sheet: np.ndarray, support: SceneSupport, find_on: FindOn) -> Iterator[tuple[Found, Prior, bool]]:
    """What is found on the ground place by place, and then by the colour of the sheet."""
    for cells in (None, sheet):
        by_color = cells is not None
        print(f"what was found lies flat on the ground: telling it {'by its colour' if by_color else 'place by place'}")
        try:
            yield *find_on(support, True, by_color, cells), by_color
        except StepError as error:
            print(f"nothing is told from it so: {error}")


def _take_nearest(foot: np.ndarray) -> np.ndarray:
    """(N, N) bool: the connected part of a foot that is nearest to the middle."""
    parts, count = ndimage.label(foot)
    if not count:
        return foot
    rows, columns = np.nonzero(foot)
    nearest = np.hypot(rows - len(foot) / 2, columns - len(foot) / 2).argmin()
    part: np.ndarray = parts == parts[rows[nearest], columns[nearest]]
    return part
