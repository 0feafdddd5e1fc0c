"""What Segment Anything cuts out of each photo where the other photos show the object, and how far that agrees with them."""

from collections.abc import Callable

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import space_evenly
from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.segment.outlines.windows import resample_map
from zeroshop_steps.segment.scene import Guess, MaskScene

CHANNELS = ("boxed", "boxed_agrees", "pointed", "pointed_agrees", "prompted_known")
MOST_ODDS = 8.0  # of the network; larger ones say no more
MOST_VIEWS = 24  # that are asked, as each takes seconds; the others learn from the hull


def prepare(scene: MaskScene, guess: Guess) -> Callable[[int], list[np.ndarray]] | None:
    """Log odds, scaled to -1 to 1, of the thing in the box around the hull and of the largest thing at points of it; and the overlaps.

    A box keeps it to what the views share; points also find a part that their hull lacks.
    """
    segmenter, hull = scene.segmenter, guess.hull
    if segmenter is None or hull is None:
        return None
    asked = set(space_evenly(len(scene.views), MOST_VIEWS))

    def see(index: int) -> list[np.ndarray]:
        shared, camera = hull.find_shared(index), scene.cameras[index]
        if index not in asked or not shared.any():
            return [np.zeros(shared.shape, np.float32)] * len(CHANNELS)
        view, window = scene.views[index], scene.windows[index]
        around, masks = segmenter.cut(scene.photos[index], view, window, shared)
        channels = []
        for odds in masks:
            own = resample_map(np.clip(odds / MOST_ODDS, -1, 1), around, window, view, camera)
            channels += [own, np.full_like(own, compute_overlap(own > 0, shared))]
        return [*channels, np.ones_like(channels[0])]

    return see


def see_whole(scene: MaskScene, closer: MaskScene, guess: Guess) -> list[np.ndarray] | None:
    """(h, w) log odds in each photo of the largest thing at points of the hull, 0 where nobody was asked; None without Segment Anything.

    Args:
        scene, closer: the whole photos, and the windows of them that are looked at.
        guess: the hull.
    """
    see = prepare(closer, guess)
    if see is None:
        return None
    maps = []
    for index, (window, view, camera) in enumerate(zip(closer.windows, scene.views, scene.cameras, strict=True)):
        part = window.scaled(camera.width_px / view.camera.width_px, camera.height_px / view.camera.height_px)
        odds = np.zeros((camera.height_px, camera.width_px), np.float32)
        size_px = part.right - part.left, part.bottom - part.top
        if min(size_px) > 0:  # a window of a large photo may be less than a pixel here
            odds[part.slices] = cv2.resize(MOST_ODDS * see(index)[CHANNELS.index("pointed")], size_px, interpolation=cv2.INTER_AREA)
        maps.append(odds)
    return maps
