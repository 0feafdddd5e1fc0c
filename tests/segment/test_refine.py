"""What the masks share is carved to one standing thing."""

import numpy as np
import pytest

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.refine import _close_holes, _drop_floating, _learn_colors, _restore_lost_foot


def block(*boxes):
    occupied = np.zeros((40, 40, 60), bool)
    for low, high in boxes:
        occupied[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    return occupied


def test_what_floats_goes_and_what_stands_or_touches_stays():
    body = ((15, 15, 3), (25, 25, 30))
    finial = ((19, 19, 32), (21, 21, 36))  # a thin neck of two voxels was lost between them
    foot = ((30, 30, 3), (33, 33, 20))  # a part of its own that stands
    floating = ((2, 2, 45), (30, 30, 58))
    assert np.array_equal(_drop_floating(block(body, finial, foot, floating), 2.0), block(body, finial, foot, floating) & ~block(floating))
    kept = block(body, finial, foot)
    assert np.array_equal(_drop_floating(kept | block(floating), 2.0), kept)
    assert np.array_equal(_drop_floating(block(body), 2.0), block(body))
    assert not _drop_floating(block(), 2.0).any()


def test_an_object_whose_foot_was_carved_off_is_kept_and_may_have_it_back():
    body, splinter = ((15, 15, 14), (25, 25, 50)), ((33, 33, 2), (35, 35, 4))
    kept = _drop_floating(block(body, splinter), 2.0)
    assert np.array_equal(kept, block(body))
    assert np.array_equal(_restore_lost_foot(kept, 2.0), block(((15, 15, 2), (25, 25, 50))))
    standing = block(((15, 15, 3), (25, 25, 50)), ((12, 12, 45), (28, 28, 50)))
    assert np.array_equal(_restore_lost_foot(standing, 2.0), standing), "what lies below a rim is no foot where the body stands"
    assert not _restore_lost_foot(block(), 2.0).any()


def test_a_hole_in_the_objects_own_colours_is_none():
    mask = np.zeros((60, 80), np.float32)
    mask[10:50, 10:70] = 1.0
    mask[20:30, 20:30] = mask[20:30, 50:60] = 0.0  # the floor of a bowl; a handle that one looks through
    mask[40:55, 30:34] = 0.0  # no hole: it opens to the outside
    color = np.where(mask > 0, 1.5, -1.0)
    color[20:30, 20:30] = color[40:55, 30:34] = 1.2
    found = _close_holes(mask, color)
    expected = mask.copy()
    expected[20:30, 20:30] = 1.0
    assert np.array_equal(found, expected)
    assert np.array_equal(_close_holes(np.zeros((5, 6), np.float32), np.ones((5, 6))), np.zeros((5, 6)))
    assert np.array_equal(_close_holes(np.ones((5, 6), np.float32), np.ones((5, 6))), np.ones((5, 6)))


@pytest.mark.parametrize(("share", "missing"), [(0.0, "object"), (1.0, "background")])
def test_what_fills_the_photos_or_is_nowhere_is_told(share, missing):
    hull = np.full((40, 60), bool(share))
    with pytest.raises(StepError, match=f"no place is surely {missing}; keep the whole object in the middle"):
        _learn_colors([np.full((40, 60, 3), 90.0, np.float32)], [hull], [np.zeros((40, 60), np.float32)])
