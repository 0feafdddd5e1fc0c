"""Photo files of all kinds: upright, at a bounded size, with their EXIF and what is transparent in them."""

from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from helpers.shoot import HEIGHT, WIDTH
from zeroshop_steps.capture.mask_files import read_user_mask
from zeroshop_steps.capture.photo_files import is_cut_out, read_photo, write_upright
from zeroshop_steps.capture.photos import import_photos
from zeroshop_steps.geometry.imaging.images import read_image, read_mask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json


@pytest.mark.slow
def test_photos_of_many_megapixels_are_read_in_bounded_memory(tmp_path):
    path = tmp_path / "large.jpg"
    Image.new("RGB", (15000, 13000), (90, 120, 30)).save(path, quality=30)
    photo = read_photo(path, 1000)
    assert photo.size_px == (1000, 867) and photo.stored_px == (15000, 13000)
    assert np.abs(photo.pixels.mean((0, 1)) - (90, 120, 30)).max() < 6  # levels, by compression


def test_an_image_beyond_all_cameras_is_refused(tmp_path):
    Image.new("1", (20000, 13000)).save(tmp_path / "map.png")
    with pytest.raises(StepError, match="20000 x 13000 px, more than 250 megapixels"):
        read_photo(tmp_path / "map.png", 1000)


def test_turned_photos_are_turned_upright_and_keep_their_focal_length(shoot):
    for index in range(9):
        with Image.open(shoot.image(index)) as image:
            exif = image.getexif()
            exif[0x0112] = 6  # stored lying, to be turned clockwise
            exif.get_ifd(0x8769)[0xA405] = 28  # focal length on a 35 mm film
            image.save(shoot.image(index), exif=exif)
    import_photos(shoot.images, None, 8, shoot.out)
    facts = read_json(shoot.out / "capture.json")
    assert (facts["width_px"], facts["height_px"]) == (HEIGHT, WIDTH)
    with Image.open(shoot.out / "images" / "000000.jpg") as image:
        assert image.size == (HEIGHT, WIDTH)
        assert image.getexif().get(0x0112, 1) == 1
        assert image.getexif().get_ifd(0x8769)[0xA405] == 28


def test_tags_that_count_pixels_follow_a_photo_that_is_reduced(shoot):
    """Cameras that name no focal length of 35 mm film say how many pixels lie on a unit of their sensor."""
    with Image.open(shoot.image(0)) as image:
        exif = image.getexif()
        tags = {0x920A: IFDRational(10), 0xA002: 2 * WIDTH, 0xA003: HEIGHT, 0xA20E: IFDRational(1270), 0xA20F: IFDRational(1270), 0xA210: 2}
        exif.get_ifd(0x8769).update(tags)
        image.save(shoot.image(0), exif=exif)
    assert pycolmap.infer_camera_from_image(shoot.image(0)).mean_focal_length() == pytest.approx(500)
    path = shoot.out.with_suffix(".jpg")
    write_upright(shoot.image(0), path, WIDTH // 2)
    reduced = pycolmap.infer_camera_from_image(path)
    assert (reduced.width, reduced.has_prior_focal_length) == (WIDTH // 2, True)
    assert reduced.mean_focal_length() == pytest.approx(250)
    with Image.open(path) as image:
        details = image.getexif().get_ifd(0x8769)
    assert (details[0xA002], details[0xA003]) == (WIDTH, HEIGHT // 2)


def test_gif_photos_are_read_and_films_among_them_are_not(shoot, capsys):
    with Image.open(shoot.image(2)) as photo, Image.open(shoot.image(3)) as other:
        photo.save(shoot.image(2).with_suffix(".gif"))
        photo.save(shoot.images / "z.gif", save_all=True, append_images=[other])
    shoot.image(2).unlink()
    import_photos(shoot.images, None, 8, shoot.out)
    names = read_json(shoot.out / "capture.json")["source_names"]
    assert names[2] == "IMG_0002.gif" and "z.gif" not in names
    assert "z.gif is a film of 2 pictures; give it alone" in capsys.readouterr().err


def test_heic_photos_are_converted_upright_with_their_exif(shoot):
    (shoot.images / "IMG_0002.HEIC").write_bytes((Path(__file__).parent / "data" / "turned.heic").read_bytes())
    shoot.image(2).unlink()
    import_photos(shoot.images, None, 8, shoot.out)
    assert read_json(shoot.out / "capture.json")["source_names"][2] == "IMG_0002.HEIC"
    with Image.open(shoot.out / "images" / "000002.jpg") as image:
        assert image.format == "JPEG" and image.size == (HEIGHT, WIDTH)
        assert image.getexif().get(0x0112, 1) == 1
        assert image.getexif().get_ifd(0x8769)[0xA405] == 28


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
@pytest.mark.parametrize("channels", [1, 3])
def test_twelve_bits_in_sixteen_are_told(tmp_path, name, channels):
    levels = np.random.default_rng(0).integers(0, 4096, (HEIGHT, WIDTH, channels)).astype(np.uint16)
    for factor in (1, 16):
        cv2.imwrite(str(tmp_path / name), levels * factor)
        if factor == 16:
            assert read_photo(tmp_path / name, 1000).pixels.mean() == pytest.approx(127, abs=3)
            continue
        with pytest.raises(StepError, match="has 16 bits, of which its brightest pixel fills 12 at most.*export it as JPEG or PNG of 8"):
            read_photo(tmp_path / name, 1000)


@pytest.mark.parametrize("suffix", [".jfif", ".JPE", ".mpo"])
def test_jpegs_of_other_names_are_copied_as_they_are(shoot, suffix):
    for index in range(9):
        shoot.image(index).rename(shoot.image(index).with_suffix(suffix))
    import_photos(shoot.images, None, 9, shoot.out)
    copied = (shoot.out / "images/000003.jpg").read_bytes()
    assert copied == shoot.image(3).with_suffix(suffix).read_bytes() and copied[:2] == b"\xff\xd8"


def cut_out(shoot, index, opacity=250):
    """A photo whose background was removed, as a PNG; phones leave the object a little transparent."""
    alpha = Image.fromarray(np.where(shoot.disk(x=70 + index), opacity, 0).astype(np.uint8))
    photo = Image.open(shoot.image(index)).convert("RGB")
    photo.putalpha(alpha)
    shoot.image(index).unlink()
    photo.save(shoot.images / f"IMG_{index:04d}.png")


def test_photos_with_a_transparent_background_bring_their_masks(shoot):
    assert not is_cut_out(shoot.images)
    for index in range(9):
        cut_out(shoot, index)
    assert is_cut_out(shoot.images)
    import_photos(shoot.images, shoot.images, 8, shoot.out)
    for index in range(9):
        assert np.array_equal(read_mask(shoot.out / f"masks/{index:06d}.png"), shoot.disk(x=70 + index))
    assert read_image(shoot.out / "images/000000.png").shape == (HEIGHT, WIDTH, 3)


def test_photos_that_are_opaque_have_no_masks_of_their_own(shoot):
    for index in range(9):
        cut_out(shoot, index)
    Image.open(shoot.images / "IMG_0004.png").convert("RGB").save(shoot.images / "IMG_0004.png")
    assert not is_cut_out(shoot.images)
    said = []
    for number, opacity in ((2, 255), (3, 0)):
        image = Image.open(shoot.images / "IMG_0000.png").convert("RGB")
        image.putalpha(opacity)
        image.save(shoot.images / f"IMG_000{number}.png")
        with pytest.raises(StepError) as error:
            read_user_mask(*[shoot.images / f"IMG_000{number}.png"] * 2, read_photo(shoot.images / f"IMG_000{number}.png", 1000))
        said.append(str(error.value))
    assert "nothing in it is transparent" in said[0] and "all in it is transparent; remove its background alone" in said[1]
    for number in (2, 3, 4):
        (shoot.images / f"IMG_000{number}.png").unlink()
    assert is_cut_out(shoot.images)
