"""Choose the photos that are used: not those much more blurred than the others, and not more than serve the surface."""

from collections.abc import Sequence

import numpy as np

from zeroshop_steps.capture.frame_quality import BLURRED_SHARE, MOST_EDGE_BLUR_PX

BLURRED_RATIO = 1.6  # of the usual blur of edges: a photo beyond that, and of low contrast throughout, is left out


def find_blurred(sharpnesses: Sequence[float], blurs_px: Sequence[float]) -> list[int]:
    """Numbers of the photos that are much more blurred than the others, in their contrast and in their sharpest edges.

    Args:
        sharpnesses, blurs_px: as `frames.measure_sharpness` and `frames.measure_edge_blur_px` give them: a blur of 0 px means that
            there is hardly an edge.
    """
    sharp, blur = np.array(sharpnesses), np.array(blurs_px)
    if not len(sharp):
        return []
    beyond = max(MOST_EDGE_BLUR_PX, BLURRED_RATIO * float(np.median(blur)))
    return np.flatnonzero((sharp < BLURRED_SHARE * np.median(sharp)) & ((blur > beyond) | (blur == 0))).tolist()


def thin_out(common: np.ndarray, sharpnesses: Sequence[float], most: int) -> list[int]:
    """Numbers of at most `most` photos: again and again, of the two most alike, the less sharp one goes.

    So directions that were photographed often are thinned out first, and a photo that nothing else resembles stays.

    Args:
        common: (N, N) symmetric: how much two photos show of the same.
        sharpnesses: (N,) of the photos.
        most: photos to keep.
    """
    alike = np.array(common, float)
    np.fill_diagonal(alike, -np.inf)
    kept = set(range(len(alike)))
    while len(kept) > most:
        one, other = divmod(int(alike.argmax()), len(alike))
        worse = one if sharpnesses[one] < sharpnesses[other] else other
        kept.remove(worse)
        alike[worse] = alike[:, worse] = -np.inf
    return sorted(kept)
