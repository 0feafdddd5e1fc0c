"""What Segment Anything cuts out of each photo where the other photos show the object, and how far that agrees with them."""

from collections.abc import Callable

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
