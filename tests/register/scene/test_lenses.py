"""A lens whose distortion folds the picture is told from real ones."""

import numpy as np
import pycolmap
import pytest

from helpers.given import small_ring, write_lenses
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.register.scene.lenses import folds, import_images
from zeroshop_steps.runtime.errors import StepError


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


@pytest.fixture
def pictures(tmp_path):
    """Pictures of noise."""
    rng = np.random.default_rng(0)
    for camera in small_ring():
        write_image(tmp_path / "images" / camera.name, rng.integers(0, 255, (120, 160, 3)).astype(np.uint8))
    return tmp_path


def test_registrations_start_from_the_lenses_that_came_with_the_capture(pictures):
    """They have no distortion, and their middle is not that of the picture; without them, a focal length is guessed."""
    given = write_lenses(pictures / "cameras.json")
    import_images(pictures / "known.db", read_image_set(pictures), 1000.0)
    (pictures / "cameras.json").unlink()
    import_images(pictures / "unknown.db", read_image_set(pictures))
    found = {}
    for name in ("known", "unknown"):
        with pycolmap.Database.open(pictures / f"{name}.db") as database:
            [found[name]] = database.read_all_cameras()
    lens = next(iter(given.images.values())).lens
    assert (found["known"].model.name, tuple(found["known"].params)) == (lens.model, lens.params)
    assert found["known"].has_prior_focal_length and not found["unknown"].has_prior_focal_length


def test_lenses_of_other_pictures_are_an_error(pictures):
    write_lenses(pictures / "cameras.json", {small_ring()[2].name: "another.png"})
    with pytest.raises(StepError, match=f"lack 1 of 12 images, such as {small_ring()[2].name}"):
        read_image_set(pictures)
