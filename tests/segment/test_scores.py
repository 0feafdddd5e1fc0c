"""Masks are rated by what can be measured without the truth."""

from dataclasses import fields, replace

import numpy as np
import pytest

from zeroshop_steps.segment.quality.mask_scores import REASONS, Measures, _measure_beyond, score

PERFECT = Measures(*(0.0,) * len(fields(Measures)))


def test_perfect_masks_are_likely_right():
    assert score(PERFECT).probability > 0.8


@pytest.mark.parametrize("name", [field.name for field in fields(Measures)])
def test_what_is_worse_is_not_rated_better(name):
    worse = score(replace(PERFECT, **{name: 0.5}))
    assert worse.probability <= score(PERFECT).probability and worse.doubt in REASONS


def test_masks_that_are_wrong_in_all_respects_are_refused():
    assert score(Measures(*(0.8,) * len(fields(Measures)))).probability < 0.1


@pytest.mark.parametrize("share", [0.0, 0.1, 0.2])
def test_colors_of_a_part_that_masks_lack_are_found_beyond_them(share):
    rng = np.random.default_rng(0)
    image = np.full((120, 160, 3), (40, 80, 160), np.float32)
    image[40:80, 40:100] = (180, 60, 40)
    image[5:15, 5:15] = (180, 60, 40)  # apart from the object: another thing of its colours
    image += rng.normal(0, 3, image.shape).astype(np.float32)
    mask = np.zeros((120, 160), bool)
    mask[40:80, 40 : 100 - round(60 * share)] = True
    assert _measure_beyond([image] * 3, [mask] * 3) == pytest.approx(share / (1 - share), abs=0.05)
    assert _measure_beyond([image] * 2, [np.zeros_like(mask)] * 2) == 0.0
