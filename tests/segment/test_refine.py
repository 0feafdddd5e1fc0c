"""What the masks share is carved to one standing thing."""

import numpy as np

from zeroshop_steps.segment.refine import _without_floating


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
    assert np.array_equal(
        _without_floating(block(body, finial, foot, floating), 2.0), block(body, finial, foot, floating) & ~block(floating)
    )
    kept = block(body, finial, foot)
    assert np.array_equal(_without_floating(kept | block(floating), 2.0), kept)
    assert np.array_equal(_without_floating(block(body), 2.0), block(body))
    assert not _without_floating(block(), 2.0).any()
