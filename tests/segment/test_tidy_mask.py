"""Masks are tidied by the hull that all photos share."""

import numpy as np

from zeroshop_steps.segment.quality.tidy_mask import tidy_mask


def test_islands_and_pinholes_go():
    mask = np.zeros((60, 80), np.float32)
    mask[10:50, 10:50] = 1.0
    hull = mask > 0.5
    mask[20:22, 20:22] = 0.0  # a pinhole
    mask[30:50, 65:80] = 1.0  # an island off the hull
    assert np.array_equal(tidy_mask(mask, hull) > 0.5, hull)
    handle = hull.copy()
    handle[30:40, 30:40] = False  # a hole that the hull has, too
    mask[30:40, 30:40] = 0.0
    assert np.array_equal(tidy_mask(mask, handle) > 0.5, handle)
