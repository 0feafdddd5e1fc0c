"""Cut-outs of every format bring their masks, and a black background is no lack of light."""

import cv2
import numpy as np
import pytest
from PIL import Image

from helpers.shoot import Shoot, taken
from zeroshop_steps.capture.frame_quality import collect_image_warnings, measure_level
from zeroshop_steps.capture.photo_files import is_cut_out
from zeroshop_steps.capture.photos import import_photos


def cut_out(shoot, index, suffix, **options):
    """Save a photo anew with a transparent background."""
    photo = Image.open(shoot.image(index)).convert("RGB")
    if suffix == ".palette.png":
        photo = photo.quantize(255)
        pixels = np.where(shoot.disk(), np.asarray(photo), 255).astype(np.uint8)
        made = Image.fromarray(pixels, "P")
        made.putpalette(photo.getpalette()[: 255 * 3] + [0, 0, 0])
        photo, options = made, {"transparency": 255}
    else:
        photo.putalpha(Image.fromarray(shoot.disk().astype(np.uint8) * (1 if suffix == ".tif" else 255)))  # as some programs write it
        options |= {"speed": 10} if suffix == ".avif" else {}
    shoot.image(index).unlink()
    photo.save(shoot.images / f"IMG_{index:04d}{suffix}", **options)


@pytest.mark.parametrize("suffix", [".webp", ".tif", ".palette.png", ".avif"])
def test_cut_outs_of_every_format_bring_their_masks(shoot, suffix, tmp_path, capsys):
    for index in range(9):
        cut_out(shoot, index, suffix)
    assert is_cut_out(shoot.images)
    import_photos(shoot.images, None, 9, tmp_path / "without")
    assert "background of the photos is transparent; to use it as masks, name" in capsys.readouterr().err
    shoot.masks = shoot.images
    assert taken(shoot) > 0.97


@pytest.mark.parametrize(("light", "dark"), [(1.0, False), (0.2, True)])
def test_a_black_background_is_no_lack_of_light(shoot, light, dark):
    levels = [measure_level((cv2.imread(str(shoot.image(index))) * shoot.disk()[..., None] * light).astype(np.uint8)) for index in range(9)]
    flash = np.where(Shoot.disk()[..., None], int(200 * light), 22).astype(np.uint8).repeat(3, 2)
    levels.append(measure_level(flash))
    told = collect_image_warnings(list("abcdefghij"), [1.0] * 10, levels, [1.0] * 10)
    assert bool(told) == dark
