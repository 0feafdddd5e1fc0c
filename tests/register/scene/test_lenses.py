"""A lens whose distortion folds the picture is told from real ones."""

import pycolmap
import pytest

from zeroshop_steps.register.scene.lenses import folds


def make_lens(focal_px, distortion):
    return pycolmap.Camera(model="SIMPLE_RADIAL", width=1000, height=750, params=[focal_px, 500.0, 375.0, distortion])


@pytest.mark.parametrize(
    ("focal_px", "distortion", "folded"),
    [(1389.0, 0.0, False), (1389.0, -0.3, False), (1389.0, 0.5, False), (700.0, -0.15, False), (513.0, -0.84, True), (1389.0, -3.0, True)],
)
def test_a_lens_that_folds_the_picture_is_told(focal_px, distortion, folded):
    assert folds(make_lens(focal_px, distortion)) == folded


def test_a_pinhole_camera_folds_nothing():
    assert not folds(pycolmap.Camera(model="PINHOLE", width=800, height=600, params=[900.0, 900.0, 410.0, 290.0]))
