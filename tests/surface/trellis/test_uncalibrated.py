"""Trellis without cameras: the seed that looks most like the photos is chosen, and the height that the user gives is the mesh's."""

import shutil

import numpy as np
import pytest

from helpers.stand_in_generator import Deformation, StandInGenerator
from zeroshop_steps.geometry.imaging.images import list_images, read_mask, write_mask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.trellis import uncalibrated
from zeroshop_steps.surface.trellis.uncalibrated import as_generated, choose_likeliest, read_pictures, scale_by_height

SQUASHED, PALE = Deformation((0.0, 0.0, -0.3), 0.0, 0.03), Deformation(color_noise=0.4)
SLIGHT = Deformation((0.02, -0.02, 0.01), 0.01, 0.03, 0.9)


@pytest.fixture
def capture(carton, tmp_path):
    """The carton's photos with masks, and no cameras."""
    for part in ("images", "masks"):
        shutil.copytree(carton.cameras / part, tmp_path / part)
    return tmp_path


@pytest.mark.slow
def test_the_seed_whose_views_are_most_alike_is_chosen_and_is_as_high_as_the_user_says(carton, capture, monkeypatch):
    """One with the wrong proportions and one with the wrong colours are less alike."""
    monkeypatch.setattr(uncalibrated, "AZIMUTHS", 24)
    monkeypatch.setattr(uncalibrated, "ELEVATIONS_DEG", (5.0, 35.0))
    pictures = [(image, mask) for _, image, mask in read_pictures(capture)]
    generate = StandInGenerator(carton.mesh, (SQUASHED, PALE, SLIGHT))
    index, mesh, errors = choose_likeliest([*(as_generated(generate(seed)) for seed in range(3)), None], pictures)
    assert index == 2 and errors[2] < 0.7 * min(errors[:2]) and errors[3] == 1.0
    scaled = scale_by_height(mesh, 0.115)
    assert np.ptp(scaled.vertices[:, 2]) == pytest.approx(115.0)
    np.testing.assert_allclose(scaled.vertices.min(0), -scaled.vertices.max(0), atol=1e-9)


def test_the_first_photo_and_the_one_opposite_are_taken(capture):
    names = [path.name for path in list_images(capture / "images")]
    assert [name for name, _, _ in read_pictures(capture)] == [names[0], names[len(names) // 2]]


def test_photos_without_masks_or_with_an_empty_one_are_refused(capture):
    first = list_images(capture / "masks")[0]
    write_mask(first, np.zeros_like(read_mask(first)))
    with pytest.raises(StepError, match="is empty; it must be 255 on the object"):
        read_pictures(capture)
    shutil.rmtree(capture / "masks")
    with pytest.raises(StepError, match="without cameras no masks are found; give them"):
        read_pictures(capture)
    with pytest.raises(StepError, match="made no surface"):
        choose_likeliest([None, None], [])
