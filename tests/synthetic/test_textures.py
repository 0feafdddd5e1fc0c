"""Filtered texture look-up."""

import numpy as np
import pytest

from zeroshop_steps.geometry.imaging.srgb import linear_to_srgb, srgb_to_linear
from zeroshop_steps.synthetic.rendering.textures import LINEAR_OF_BYTE, build_pyramid, encode_srgb, sample_mip_levels


def look(pyramid, u, v, footprint=0.0):
    return sample_mip_levels(pyramid.texels, pyramid.levels, pyramid.wrap, LINEAR_OF_BYTE, u, v, footprint, 0.0, 0.0, footprint)


def test_srgb_round_trip():
    codes = np.arange(256, dtype=np.uint8)
    assert np.array_equal(encode_srgb(LINEAR_OF_BYTE[codes]), codes)
    assert np.allclose(linear_to_srgb(srgb_to_linear(np.linspace(0, 1, 50))), np.linspace(0, 1, 50), atol=1e-6)


def test_texels_are_where_the_mesh_puts_them():
    image = np.arange(8 * 4 * 3, dtype=np.uint8).reshape(4, 8, 3)
    pyramid = build_pyramid(image)
    for row, column in ((0, 0), (3, 7), (1, 5)):
        assert look(pyramid, (column + 0.5) / 8, 1 - (row + 0.5) / 4) == pytest.approx(LINEAR_OF_BYTE[image[row, column]], rel=1e-5)


def test_a_wide_footprint_sees_the_mean_of_light_not_of_codes():
    checker = ((np.add.outer(np.arange(64), np.arange(64)) % 2) * 255).astype(np.uint8)
    pyramid = build_pyramid(np.repeat(checker[..., None], 3, 2))
    assert look(pyramid, 0.41, 0.37, footprint=0.25)[0] == pytest.approx(0.5, abs=0.01)


def test_unused_texels_do_not_bleed_in():
    image = np.zeros((64, 64, 3), np.uint8)
    image[:, :20] = 200
    coverage = np.zeros((64, 64), bool)
    coverage[:, :20] = True
    pyramid = build_pyramid(image, coverage)
    assert look(pyramid, 18.5 / 64, 0.5, footprint=8 / 64)[0] == pytest.approx(LINEAR_OF_BYTE[200], rel=0.03)


def test_edges_wrap_or_clamp():
    image = np.zeros((8, 8, 3), np.uint8)
    image[:, 0] = 255
    assert look(build_pyramid(image, wrap=True), 1.0, 0.5)[0] == pytest.approx(0.5, abs=0.01)
    assert look(build_pyramid(image), 1.0, 0.5)[0] == pytest.approx(0.0, abs=0.01)
