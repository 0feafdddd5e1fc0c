"""Masks are rated by what can be measured without the truth."""

from dataclasses import fields, replace

import pytest

from zeroshop_steps.segment.quality.mask_scores import REASONS, Measures, score

PERFECT = Measures(*(0.0,) * len(fields(Measures)))


def test_perfect_masks_are_likely_right():
    assert score(PERFECT).probability > 0.8


@pytest.mark.parametrize("name", [field.name for field in fields(Measures)])
def test_what_is_worse_is_not_rated_better(name):
    worse = score(replace(PERFECT, **{name: 0.5}))
    assert worse.probability <= score(PERFECT).probability and worse.doubt in REASONS


def test_masks_that_are_wrong_in_all_respects_are_refused():
    assert score(Measures(*(0.8,) * len(fields(Measures)))).probability < 0.1
