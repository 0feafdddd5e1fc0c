"""Whether masks that agree with each other lack a part of the object, by the outline that each photo alone shows around its mask.

A side of the object that has the ground's colours in a few photos is carved out of the common hull, and so out of all masks: they agree,
and nothing else tells that they are wrong. But where a photo is cut along its own colours and edges around such a mask (GrabCut), the cut
goes on to the outline that this photo shows. Around whole masks, it stays where they are. That holds on plain grounds, which have no
outlines of their own: on a wooden table that mirrors the light, cuts ran along its bright patches.
"""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.networks.saliency_maps import WIDTH_PX as MAPS_WIDTH_PX
from zeroshop_steps.register.ground_contrast import cut_in_band
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.thread_pool import map_in_threads
from zeroshop_steps.segment.led_by_points import MOST_DROPPED, Found
from zeroshop_steps.segment.prior_maps import weigh_maps
from zeroshop_steps.segment.windows import Window, choose_windows, cut_views

# Lengths are shares of the square root of the mask's area. Set by hand on photos of a plush toy (docs/results.md).
CUT_WIDTH_PX = 320  # of the windows that are cut; time grows with its square
BAND_SHARE = 0.25  # so far around a mask a photo may go on
SURE_SHARE = 0.02  # what lies deeper inside the mask is the object
END_PX = 2.0  # of the band, as wide
OUTGROWN_SHARE = 0.08
"""Of a mask's area. In the median photo, the cuts add 0.15 to masks that lack a side of a plush toy, and 0 to 0.05 in fifteen other
captures; on a wooden table that mirrors the light 0.08."""


def find_whole(
    views: list[View], found: Found, prior: list[np.ndarray] | None, find: Callable[[list[np.ndarray]], Found]
) -> tuple[Found, list[np.ndarray] | None]:
    """The masks with their prior, or, where the photos' own cuts go on beyond them, those that these lead, with these as the prior.

    They are taken where nearly all of them agree, and the photos add nothing to them any more. Otherwise the old ones stay, with a warning.

    Args:
        found, prior: masks that agree, on a plain ground, and what led them.
        find: the masks with a prior, (h, w) log odds of each view.
    """
    maps, growth = cut_around(views, found.masks)
    if growth <= OUTGROWN_SHARE:
        return found, prior
    print(f"the photos' own colours go on beyond the masks, by {growth:.0%} of their area: trying again, led by these")
    own = weigh_maps(maps, [view.camera for view in views])
    try:
        again = find(own)
    except StepError as error:
        print(f"the photos' own colours did not help: {error}")
        return _doubt(found, growth), prior
    if len(again.record["dropped"]) > MOST_DROPPED * len(views) or cut_around(views, again.masks)[1] > OUTGROWN_SHARE:
        return _doubt(found, growth), prior
    led = {name: found.record[name] for name in ("led_by_points", "without_points") if name in found.record}
    return replace(again, record=again.record | led | {"led_by_own_outlines": round(growth, 3)}), own


def _doubt(found: Found, growth: float) -> Found:
    """The masks, with a warning that they may lack a part."""
    warn(
        f"the masks may lack a part of the object: the photos' own colours go on beyond them, by {growth:.0%} of their area. Look at"
        " contact_sheet.png; put the object alone on a ground of other colours, or draw masks"
    )
    return replace(found, record=found.record | {"outgrown": round(growth, 3)})


def cut_around(views: list[View], masks: list[np.ndarray]) -> tuple[list[np.ndarray], float]:
    """Each photo cut along its own colours around its (H, W) bool mask.

    Returns:
        Maps of the object, (h, w) float32, 0 or 1, and how much the cuts add in the median photo, as a share of the mask's area.
    """
    windows, _ = choose_windows(masks)
    _, images = cut_views(views, windows, CUT_WIDTH_PX)

    def cut_one(view: View, window: Window, mask: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, float | None]:
        seen = cv2.resize(mask[window.slices].astype(np.float32), image.shape[1::-1], interpolation=cv2.INTER_AREA) > 0.5
        if not seen.any():
            return _lay_on_map(seen, window, view), None
        cut = _cut_around(image.clip(0, 255).astype(np.uint8), seen)
        return _lay_on_map(cut, window, view), float(cut.sum() / seen.sum() - 1)

    found = map_in_threads(cut_one, views, windows, masks, images)
    return [each for each, _ in found], float(np.median([growth for _, growth in found if growth is not None]))


def _cut_around(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: the object in an (H, W, 3) photo by a mask of it. What reaches the band's end has no outline there, and is left out."""
    size_px = float(np.sqrt(mask.sum()))
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    band_px = max(1.0, BAND_SHARE * size_px)
    cut = cut_in_band(image, mask, away <= band_px, SURE_SHARE * size_px)
    _, parts = cv2.connectedComponents((cut & ~mask).astype(np.uint8), connectivity=4)
    endless = np.unique(parts[(parts > 0) & (away > band_px - END_PX)])
    return cut & ~np.isin(parts, endless)


def _lay_on_map(cut: np.ndarray, window: Window, view: View) -> np.ndarray:
    """The cut of a window as a map of the whole photo, (h, w) float32."""
    scale = min(MAPS_WIDTH_PX / view.camera.width_px, 1.0)
    found = np.zeros((round(scale * view.camera.height_px), round(scale * view.camera.width_px)), np.float32)
    top, bottom, left, right = (round(scale * edge) for edge in (window.top, window.bottom, window.left, window.right))
    part = found[top:bottom, left:right]
    part[:] = cv2.resize(cut.astype(np.float32), part.shape[::-1], interpolation=cv2.INTER_AREA) > 0.5
    return found
