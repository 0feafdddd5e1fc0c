"""Images, masks and depth: what is written reads back, and bad files are named."""

from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.geometry.imaging.images import (
    list_images,
    read_depth_mm,
    read_image,
    read_mask,
    write_depth_mm,
    write_image,
    write_mask,
)
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import is_result


def test_an_image_that_cannot_be_written_is_a_fault_of_the_machine(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    (tmp_path / "a.png/file").touch()
    with pytest.raises(StepError, match=r"cannot write .*a.png") as error:
        write_image(tmp_path / "a.png", np.zeros((2, 2, 3), np.uint8))
    assert not is_result(error.value)


def test_images_and_masks_say_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(StepError, match="does not exist"):
        list_images(tmp_path / "nowhere")
    with pytest.raises(StepError, match="holds no images"):
        list_images(tmp_path)
    (tmp_path / "broken.png").write_bytes(b"\x89PNG broken")
    with pytest.raises(StepError, match="broken.png cannot be read"):
        read_image(tmp_path / "broken.png")
    write_mask(tmp_path / "mask.png", np.eye(4, 6, dtype=bool))
    assert np.array_equal(read_mask(tmp_path / "mask.png", (6, 4)), np.eye(4, 6, dtype=bool))
    with pytest.raises(StepError, match="mask.png is 6 x 4 px, its image is 8 x 4 px"):
        read_mask(tmp_path / "mask.png", (8, 4))


def test_color_and_depth_survive_the_disk(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    write_image(tmp_path / "a.png", image)
    assert np.array_equal(read_image(tmp_path / "a.png"), image)
    depth_mm = np.array([[0.0, 123.4], [999.9, 6000.0]])
    write_depth_mm(tmp_path / "d.png", depth_mm)
    assert np.allclose(read_depth_mm(tmp_path / "d.png"), depth_mm, atol=0.051)
