"""What is said of photos before anything long runs."""

import numpy as np
import pytest

from capture.test_video import HEIGHT, WIDTH, picture
from zeroshop_steps.app.check import check_capture
from zeroshop_steps.geometry.imaging.images import write_image


def write_photos(folder, offsets):
    """Photos of a long picture, from these places."""
    whole = picture()
    for number, offset in enumerate(offsets):
        write_image(folder / f"{number}.png", np.ascontiguousarray(whole[:HEIGHT, offset : offset + WIDTH]))
    return folder


@pytest.mark.parametrize(("step_px", "lonely"), [(40, False), (260, True)])
def test_photos_that_share_too_little_are_told(tmp_path, step_px, lonely):
    faults, warnings = check_capture(write_photos(tmp_path, range(0, 8 * step_px, step_px)))
    assert not faults
    assert [line for line in warnings if "8 of 8 photos share so little" in line] == [
        line for line in warnings if "share so little" in line
    ]
    assert any("share so little" in line for line in warnings) == lonely


def test_photos_of_which_none_can_be_read_are_named(tmp_path):
    (tmp_path / "a.jpg").touch()
    assert check_capture(tmp_path) == (["left out, cannot be read: a.jpg; export them as JPEG"], [])


def test_a_folder_without_photos_is_a_fault_like_others(tmp_path):
    (tmp_path / "notes.txt").write_text("none")
    [fault], warnings = check_capture(tmp_path)
    assert "holds no images" in fault and "it holds notes.txt: export pictures as JPEG, and name a film itself" in fault and not warnings
