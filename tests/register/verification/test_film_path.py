"""Between two frames of a film that follow each other, the camera does not jump to another side."""

import numpy as np
import pycolmap
import pytest

from register.verification.test_covisibility import look_at_middle
from zeroshop_steps.register.verification.consistency import find_jump


def film_of(azimuths_deg: dict[int, float]) -> pycolmap.Reconstruction:
    """Cameras that are registered for these frames."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pycolmap.Camera(model="SIMPLE_PINHOLE", width=400, height=300, params=[400, 200, 150], camera_id=1))
    for number, azimuth_deg in azimuths_deg.items():
        image = pycolmap.Image(name=f"{number:06d}.png", keypoints=np.zeros((0, 2)), camera_id=1, image_id=number + 1)
        model.add_image_with_trivial_frame(image, look_at_middle(azimuth_deg))
    return model


def test_a_camera_that_goes_on_is_right_also_around_twice_and_with_frames_left_out():
    assert find_jump(film_of({number: 36.0 * number for number in range(20)})).strength < 0.5
    assert find_jump(film_of({number: 36.0 * number for number in (0, 1, 2, 7, 8, 9, 15, 16)})).strength < 0.5, "a gap is no jump"
    assert find_jump(film_of({number: 90.0 * number for number in range(8)})).strength < 0.5, "a few frames are far apart"
    assert find_jump(film_of({number: 36.0 * number for number in (0, 4, 8)})) is None, "no frame follows another"


def test_one_frame_on_another_side_is_named():
    jump = find_jump(film_of({number: 20.0 * number + 180.0 * (number == 5) for number in range(12)}))
    assert jump.strength > 1.5 and jump.images == ("000005.png",) and "000005.png" in jump.found


@pytest.mark.parametrize("fold", [4, 7])
def test_a_half_that_lies_on_the_other_is_refused_without_one_to_blame(fold):
    jump = find_jump(film_of({number: 20.0 * number + 180.0 * (number >= fold) for number in range(12)}))
    assert jump.strength > 1.5 and not jump.images
    assert f"between {fold - 1:06d}.png and {fold:06d}.png" in jump.found and "160 degrees" in jump.found


def test_at_a_cut_the_camera_may_be_anywhere():
    cut = film_of({number: 20.0 * number + 180.0 * (number >= 6) for number in range(12)})
    assert find_jump(cut, cuts=(6,)).strength < 0.5 and find_jump(cut, cuts=(5,)).strength > 1.5
