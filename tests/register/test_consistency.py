"""Each check alone can find a model wrong, and names whom it blames."""

import numpy as np

from zeroshop_steps.register.consistency import ConsistencyLimits, find_first_fault
from zeroshop_steps.register.pair_support import PairSupport
from zeroshop_steps.register.silhouette_coherence import SilhouetteCoherence

NAMES = tuple("abcdefgh")


def fault(unexplained_px=0.0, contradicting=0, error_px=0.3, link=100):
    """The verdict on eight images that agree, but for what is said about image `c`."""
    count = len(NAMES)
    disagreement_px = np.zeros((count, count))
    disagreement_px[2] = unexplained_px
    coherence = SilhouetteCoherence(NAMES, np.where(np.arange(count) == 2, unexplained_px, 0.5), disagreement_px)
    supporting = np.full((count, count), 100)
    supporting[2] = supporting[:, 2] = link
    np.fill_diagonal(supporting, 0)
    against = np.zeros((count, count), int)
    against[2] = against[:, 2] = contradicting
    errors_px = dict.fromkeys(NAMES, 0.3) | {"c": error_px}
    ones, limits = dict.fromkeys(NAMES, 1.0), ConsistencyLimits()
    mask_limits_px = dict.fromkeys(NAMES, limits.unexplained_px)
    return find_first_fault(coherence, PairSupport(NAMES, supporting, against), errors_px, limits, ones, mask_limits_px)


def test_a_model_that_everything_bears_out_passes():
    assert fault() == (None, ())


def test_masks_find_a_wrong_camera():
    reason, culprits = fault(unexplained_px=40.0)
    assert "mask of c miss the other masks by 40.0 px" in reason and culprits == ("c",)


def test_contradicting_matches_find_a_wrong_camera():
    reason, culprits = fault(contradicting=300)
    assert "matches of c contradict it" in reason and culprits == ("c",)


def test_a_poor_fit_finds_a_wrong_camera():
    reason, culprits = fault(error_px=1.2)
    assert "c fits with 1.20 px" in reason and culprits == ("c",)


def test_a_loose_link_is_found():
    reason, culprits = fault(link=5)
    assert "only 35 matches hold c" in reason and culprits == ("c",)
