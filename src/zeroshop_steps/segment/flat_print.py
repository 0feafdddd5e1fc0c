"""Leave out print that lies flat on a plain table, such as a leaflet beside the object or partly below it.

Its colours are not the table's, so masks by colour have it. But what several views show at the same place of the table, and as the same
print, lies in the table's plane: print that rises lies elsewhere on the plane in every view.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.segment.ground import GroundPicture, equalize_exposure, sample_ground, take_median
from zeroshop_steps.segment.ground_structure import find_shared_print
from zeroshop_steps.segment.led_by_points import Found
from zeroshop_steps.segment.mask_agreement import assess_masks
from zeroshop_steps.segment.mask_quality import check_enough_good, describe_quality, find_contradicted
from zeroshop_steps.segment.plain_ground import find_below, find_risen_points
from zeroshop_steps.segment.tidy_mask import tidy_mask
from zeroshop_steps.segment.windows import cut_views, take_whole

LEAST_VIEWS, LEAST_SHARE = 4, 0.25
"""So many views show print alike that lies flat, and this share of those that look there: an object hides it from the others."""
LEAST_PRINT = 0.05
"""Of the masks, the share of flat print that matters: 0.15 of a tray on two leaflets, at most 0.00 of fifteen things without any. Of a
low stone on a printed sheet it is 0.16, where its outline is near to print; such sheets are told otherwise (flat_things.py)."""
GAP_CELLS = 9  # plain gaps of the print
LEAST_CELLS = 19
"""Print is wider than this. Where a low thing meets the table, its outline lies flat, too: seen from steep above, it is a band that is
hardly wider than the compared patches."""


@dataclass(frozen=True)
class FlatPrint:
    """Print that lies flat on a plain table.

    Attributes:
        picture: of the ground, where there is such print by the views that show it.
        shown: (V, N, N) bool: the cells of the picture where each view shows it.
    """

    picture: GroundPicture
    shown: np.ndarray

    def find(self, cameras: list[Camera], images: list[np.ndarray]) -> list[np.ndarray]:
        """(H, W) bool in every view, of (H, W, 3) float32 RGB images: where it shows the print."""
        return [
            (self.picture.see_cells(cells, camera) > 0.5) & (self.picture.evidence(camera, image) <= 0)
            for cells, camera, image in zip(self.shown, cameras, images, strict=True)
        ]


def find_flat_print(support: SceneSupport, cameras: list[Camera], images: list[np.ndarray], risen: np.ndarray) -> FlatPrint:
    """What several views show alike on the plane; an object hides it from others.

    Args:
        support: the plane.
        cameras, images: of the views, (H, W, 3) float32 RGB, 0 to 255.
        risen: (P, 3) sparse points above the plane. Close to the plane, the print of a box moves little from view to view; so below these
            points and between them, nothing is told.
    """
    picture, samples = sample_ground(support, cameras, images, None)
    shared = find_shared_print(picture.color, samples)
    looked = np.isfinite(samples[..., 0]).sum(0)
    flat = (shared.sum(0) >= np.maximum(LEAST_VIEWS, LEAST_SHARE * looked)) & ~find_below(picture, risen)
    flat = _shape(cv2.MORPH_CLOSE, flat, GAP_CELLS)
    flat &= _shape(cv2.MORPH_DILATE, _shape(cv2.MORPH_OPEN, flat, LEAST_CELLS), LEAST_CELLS)
    shown = np.array([_shape(cv2.MORPH_CLOSE, alike & flat, GAP_CELLS) for alike in shared])
    return FlatPrint(_learn_from(shown, samples, picture), shown)


def _shape(operation: int, cells: np.ndarray, diameter: int) -> np.ndarray:
    """(N, N) bool: the cells after an operation of OpenCV's morphology with a disc."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (diameter, diameter))
    return np.asarray(cv2.morphologyEx(cells.astype(np.uint8), operation, disc) > 0)


def take_off_print(found: Found, views: list[View], model: SparseModel, width_px: int) -> tuple[list[np.ndarray], dict[str, Any]]:
    """What was found by the colour of a plain table, without print that lies flat on it; with too little of it, the masks as they are.

    Args:
        found: masks and their record.
        views, model: all of them, and the sparse points.
        width_px: images are looked at with this width.
    """
    cameras, images = cut_views(views, take_whole(views), width_px)
    images = equalize_exposure(found.support, cameras, images)
    printed = find_flat_print(found.support, cameras, images, find_risen_points(model.points, found.support)).find(cameras, images)
    whole = [
        cv2.resize(part.astype(np.float32), mask.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0.5
        for part, mask in zip(printed, found.masks, strict=True)
    ]
    share = float(np.median([(part & mask).sum() / max(mask.sum(), 1) for part, mask in zip(whole, found.masks, strict=True)]))
    if share < LEAST_PRINT:
        return found.masks, found.record
    left = [mask & ~part for part, mask in zip(whole, found.masks, strict=True)]
    in_full = [view.camera for view in views]
    hulls, _ = assess_masks(left, in_full)
    # Scraps of the print are left in some views, off what all share.
    masks = [
        tidy_mask((mask & ~find_contradicted(mask, hull)).astype(np.float32), hull) > 0.5 for mask, hull in zip(left, hulls, strict=True)
    ]
    _, qualities = assess_masks(masks, in_full)
    names = [camera.name for camera in in_full]
    try:
        check_enough_good(qualities, names, masks)
    except StepError as error:
        print(f"{share:.0%} of the masks is print that lies flat on the table; without it, they contradict each other: {error}")
        return found.masks, found.record
    warn("print that lies flat on the table, such as a leaflet, is left out of the masks; look at contact_sheet.png")
    return masks, found.record | describe_quality(qualities, names) | {"flat_print": round(share, 3)}


def _learn_from(shared: np.ndarray, samples: np.ndarray, picture: GroundPicture) -> GroundPicture:
    """The picture by those of the (V, N, N, 3) samples alone that show the print, (V, N, N) bool; elsewhere as it was."""
    flat = shared.any(0)
    if not flat.any():
        return picture
    color, spread, _ = take_median(np.where(shared[:, flat, None], samples[:, flat], np.nan)[:, None])
    colors, spreads = picture.color.copy(), picture.spread.copy()
    colors[flat], spreads[flat] = color[0], spread[0]
    return replace(picture, color=colors, spread=spreads)
