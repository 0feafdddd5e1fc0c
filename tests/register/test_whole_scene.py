"""A capture without masks is registered as a whole scene, and checked by its image pairs alone."""

import numpy as np
import pytest

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.register.scene.image_set import read_image_set, read_masks
from zeroshop_steps.register.verification.consistency import ConsistencyLimits, ConsistencyReport, find_contradictions
from zeroshop_steps.register.verification.epipolar_support import EpipolarSupport
from zeroshop_steps.register.verification.verdict import MAX_WRONG_PROBABILITY, judge
from zeroshop_steps.runtime.errors import StepError


def test_images_without_masks_are_a_set(tmp_path):
    for index in range(4):
        write_image(tmp_path / "images" / f"{index}.png", np.full((40, 60, 3), 40 * index, np.uint8))
    image_set = read_image_set(tmp_path)
    assert image_set.masks is None and image_set.size_px == (60, 40)
    with pytest.raises(StepError, match="no masks"):
        read_masks(image_set)


def test_the_other_checks_still_judge():
    names = tuple("abcd")
    supporting, contradicting = np.full((4, 4), 100), np.zeros((4, 4), int)
    evidence = EpipolarSupport(names, supporting, contradicting)
    ones, alike = dict.fromkeys(names, 1.0), dict.fromkeys(names, 0.3)
    assert judge(find_contradictions(None, evidence, alike, ConsistencyLimits(), ones, {})).wrong < MAX_WRONG_PROBABILITY
    verdict = judge(find_contradictions(None, evidence, alike | {"b": 1.4}, ConsistencyLimits(), ones, {}))
    assert verdict.wrong > MAX_WRONG_PROBABILITY and "b fits with 1.40 px" in verdict.reason and verdict.findings[0].images == ("b",)
    assert "silhouette_worst_px" not in ConsistencyReport(None, evidence, alike).figures()
