"""Masks by what was found in each photo alone, by a network or by the contrast to the ground, once the photos have voted in space.

Such a finder takes other things along, and now and then a part for the whole: what it says counts where the photos agree. On the ground
the geometry then decides as in support_plane, with the finder as a prior. Where there is no ground, what the photos agree on is the
object.
"""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.register.ground_contrast import find_contrasting_thing
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.thread_pool import map_in_threads
from zeroshop_steps.segment.mask_agreement import assess_masks
from zeroshop_steps.segment.mask_quality import MasksRejected, check_enough_good, describe_quality, find_rim_px, move_rim
from zeroshop_steps.segment.outline import follow_edges
from zeroshop_steps.segment.tidy_mask import tidy_mask

PRIOR_ODDS = 2.5
"""Log odds where the finder is sure and the photos agree: more than the ground or colours can say, less than both."""

CONTRAST_ODDS = 1.0  # log odds by the contrast to a plain table in single images: less than what the table's colour or all views say

Masks = tuple[list[np.ndarray], dict[str, Any]]


def find_by_maps(maps: list[np.ndarray], views: list[View], find_on_ground: Callable[[list[np.ndarray]], Masks]) -> Masks:
    """(H, W) bool masks of all views, and the record of their quality.

    Args:
        maps: (h, w) of each view, 0 to 1.
        views: the registered views.
        find_on_ground: masks and record by the ground and a prior, (h, w) log odds of each view.

    Raises:
        StepError: too few masks agree.
    """
    try:
        return find_on_ground(weigh_maps(maps, [view.camera for view in views]))
    except MasksRejected:
        raise
    except StepError as error:
        print(f"no ground that helps: {error}")
        masks, record = find_without_ground(maps, views)
        return masks, record | {"without_ground": str(error)}


def weigh_maps(maps: list[np.ndarray], cameras: list[Camera], most_odds: float = PRIOR_ODDS) -> list[np.ndarray]:
    """Log odds of the object, (h, w), at most `most_odds` either way, by maps of these sizes.

    They are 0 where a photo contradicts the hull of all: it takes something else along, or a part for the whole. At the hull's rim,
    which is as coarse as its voxels, the photo decides.
    """
    hulls, _ = assess_masks([found > 0.5 for found in maps], _resize_cameras(cameras, maps))

    def weigh(found: np.ndarray, hull: np.ndarray) -> np.ndarray:
        odds = most_odds * (2 * found - 1)
        grown, shrunk = move_rim(hull, find_rim_px(hull))
        contradicted = (odds > 0) & ~grown | (odds < 0) & shrunk
        return np.where(contradicted | ~hull.any(), 0.0, odds).astype(np.float32)

    return map_in_threads(weigh, maps, hulls)


def weigh_contrast(images: list[np.ndarray], cameras: list[Camera]) -> list[np.ndarray]:
    """Log odds, (H, W), of the object by what differs from the plain ground in each image alone, once the images have voted."""

    def find_thing(image: np.ndarray, camera: Camera) -> np.ndarray:
        found = find_contrasting_thing(image.clip(0, 255).astype(np.uint8)).astype(np.float32)
        return cv2.resize(found, (camera.width_px, camera.height_px), interpolation=cv2.INTER_LINEAR)

    return weigh_maps(map_in_threads(find_thing, images, cameras), cameras, CONTRAST_ODDS)


def find_without_ground(maps: list[np.ndarray], views: list[View]) -> tuple[list[np.ndarray], dict[str, Any]]:
    """(H, W) bool masks by the maps alone, without what lies off the hull that they share, and the record of their quality.

    Raises:
        StepError: too few agree.
    """
    cameras = _resize_cameras([view.camera for view in views], maps)
    hulls, _ = assess_masks([found > 0.5 for found in maps], cameras)
    tidied = [tidy_mask(found, hull) if hull.any() else found for found, hull in zip(maps, hulls, strict=True)]
    _, qualities = assess_masks([mask > 0.5 for mask in tidied], cameras)
    names = [view.camera.name for view in views]
    check_enough_good(qualities, names, tidied)
    return map_in_threads(lambda mask, view: follow_edges(mask, view.image()), tidied, views), describe_quality(qualities, names)


def _resize_cameras(cameras: list[Camera], maps: list[np.ndarray]) -> list[Camera]:
    return [camera.resized(found.shape[1], found.shape[0]) for camera, found in zip(cameras, maps, strict=True)]
