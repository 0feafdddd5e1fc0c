"""Masks as other tools write them: their names, levels, palettes and sizes."""

import re

import cv2
import numpy as np
import pytest
from PIL import Image

from helpers.shoot import HEIGHT, WIDTH, Shoot, taken
from zeroshop_steps.capture.mask_names import find_masks, split_masks
from zeroshop_steps.capture.photos import import_photos
from zeroshop_steps.geometry.imaging.images import compute_overlap, read_mask, write_mask
from zeroshop_steps.runtime.errors import StepError

DAVIS = [0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0]


@pytest.mark.parametrize(
    "name",
    ["{stem}.PNG", "{stem}_mask.png", "{stem}.mask.png", "{name}", "mask_{stem}.png", "{name}.png", "{stem}.tif", "{name}_seg.webp",
     "{lower}-Mask.png", "mask_{number}.png", "{number}.bmp", "object-{name}.mask.PNG", "{stem}_mask.gif", "{stem}.pgm"],
)  # fmt: skip
def test_masks_are_found_by_one_scheme_of_names(tmp_path, name):
    shoot = Shoot(tmp_path, 9)
    for index in range(9):
        path = shoot.image(index)
        new = name.format(stem=path.stem, name=path.name, lower=path.stem.lower(), number=path.stem[4:])
        Image.fromarray(shoot.disk().astype(np.uint8) * 255).save(shoot.masks / f"next_{new}")
        shoot.mask(index).unlink()
        (shoot.masks / f"next_{new}").rename(shoot.masks / new)
    assert taken(shoot) > 0.99


def test_a_number_in_a_name_is_not_cut(tmp_path):
    photos = [tmp_path / f"IMG_{number}.jpg" for number in (1, 2, 10, 21)]
    for photo in photos[1:]:
        write_mask(tmp_path / "masks" / f"{photo.stem}_mask.png", np.ones((4, 4), bool))
    names = find_masks(photos, tmp_path / "masks")
    assert {photo.stem: mask.name for photo, mask in names.found.items()} == {
        stem: f"{stem}_mask.png" for stem in ("IMG_2", "IMG_10", "IMG_21")
    }
    assert "named for it as IMG_2_mask.png is for IMG_2.jpg" in names.expect(photos[0], tmp_path / "masks")


@pytest.mark.parametrize("name", ["{}.png", "{:06d}.png", "frame_{:02d}.png"])
def test_masks_are_found_by_numbers_whatever_their_zeros(tmp_path, name):
    photos = [tmp_path / f"IMG_{number:04d}.jpg" for number in range(8, 12)]
    for number in range(8, 12):
        write_mask(tmp_path / "masks" / name.format(number), np.ones((4, 4), bool))
    found = find_masks(photos, tmp_path / "masks").found
    assert [found[photo].name for photo in photos] == [name.format(number) for number in range(8, 12)]
    (tmp_path / "masks" / name.format(8)).rename(tmp_path / "masks" / name.format(12))
    with pytest.raises(StepError, match="no mask in .* is named like a photo"):  # they count from 1, perhaps: nothing tells
        find_masks(photos, tmp_path / "masks")


def test_masks_that_are_left_over_are_told(tmp_path, capsys):
    shoot = Shoot(tmp_path, 9)
    for index in range(9):
        for number in (1, 2):
            write_mask(shoot.masks / f"IMG_{index:04d}_{number}.png", shoot.disk(60 + number))
        shoot.mask(index).rename(shoot.masks / f"IMG_{index:04d}_0.png")
    assert taken(shoot) > 0.99
    assert re.search(r"IMG_0000_0.png for IMG_0000.jpg, .*; other masks, such as IMG_0000_[12].png, are not used", capsys.readouterr().err)


def test_an_archive_is_no_folder(shoot, tmp_path):
    (tmp_path / "photos.zip").write_bytes(b"PK")
    with pytest.raises(StepError, match=r"image folder .*photos\.zip is a file, not a folder; unpack it"):
        import_photos(tmp_path / "photos.zip", None, 9, tmp_path / "out")
    with pytest.raises(StepError, match=r"mask folder .*photos\.zip is a file, not a folder; unpack it"):
        import_photos(shoot.images, tmp_path / "photos.zip", 9, tmp_path / "out")


def test_masks_among_the_photos_are_no_photos(shoot, tmp_path, capsys):
    for index in range(9):
        shoot.mask(index).rename(shoot.images / f"IMG_{index:04d}_mask.png")
    paths = sorted(shoot.images.iterdir())
    assert [len(part) for part in split_masks(paths)] == [9, 9]
    import_photos(shoot.images, None, 9, tmp_path / "without")
    assert "left out, masks among the photos: IMG_0000_mask.png" in capsys.readouterr().err
    shoot.masks = shoot.images
    assert taken(shoot) > 0.99
    worn = [tmp_path / f"mask_{number}.jpg" for number in range(12)]
    assert split_masks(worn) == (worn, [])


def as_palette(colors):
    """A palette picture with the disk as index 1."""

    def make(disk):
        image = Image.fromarray(disk.astype(np.uint8), "P")
        image.putpalette(colors)
        return image

    return make


def as_levels(off, on, kind=np.uint8):
    return lambda disk: Image.fromarray(np.where(disk, on, off).astype(kind))


def as_two_objects(disk):
    image = Image.fromarray(np.where(disk, 1 + (np.arange(WIDTH) > 80), 0).astype(np.uint8), "P")
    image.putpalette(DAVIS)
    return image


def as_colors(off, on):
    return lambda disk: Image.fromarray(np.where(disk[..., None], on, off).astype(np.uint8))


def as_labels(disk):
    """Two objects as levels 1 and 2, and 255 around them, as some data sets mark what is not sure."""
    edge = cv2.dilate(disk.astype(np.uint8), np.ones((3, 3))) > disk
    return Image.fromarray(np.where(edge, 255, np.where(disk, 1 + (np.arange(WIDTH) > 80), 0)).astype(np.uint8))


def as_soft(disk):
    return Image.fromarray(np.clip(np.rint(cv2.GaussianBlur(disk.astype(np.float32), (0, 0), 2) * 235 + 10), 0, 255).astype(np.uint8))


MASKS = {
    "levels 0 and 1": (as_levels(0, 1), "level 1 on the object"),
    "grey 100": (as_levels(0, 100), "level 100 on the object"),
    "two bright levels": (as_levels(150, 255), "level 255 on the object"),
    "one bit": (lambda disk: Image.fromarray(disk), ""),
    "16 bits": (as_levels(0, 65535, np.uint16), "level 65535 on the object"),
    "floats": (as_levels(0, 1, np.float32), "level 1 on the object"),
    "DAVIS": (as_palette(DAVIS), "palettes, index 0 the background"),
    "two objects of a video": (as_two_objects, "palettes, index 0 the background, labels 1, 2 together as one object"),
    "a grey palette": (as_palette([0, 0, 0, 255, 255, 255]), ""),
    "a coloured background": (as_palette([0, 90, 0, 90, 0, 90]), "palettes, index 0 the background"),
    "red on black": (as_colors((0, 0, 0), (255, 0, 0)), ""),
    "two colours": (as_colors((68, 1, 84), (253, 231, 36)), "level 253 on the object"),
    "two colours of equal brightness": (as_colors((255, 0, 0), (0, 250, 0)), "colours of equal brightness, the one at the border"),
    "red on white": (as_colors((255, 255, 255), (255, 0, 0)), "colours of equal brightness, the one at the border"),
    "labels": (as_labels, "levels above 0.5 on the object, labels 1, 2 together as one object"),
    "pages of a TIFF": (as_levels(0, 255), "the first of 2 pictures in a file"),
    "a soft edge": (as_soft, ""),
}


@pytest.mark.parametrize("kind", MASKS)
def test_masks_of_any_two_levels_are_taken(shoot, kind, capsys):
    make, said = MASKS[kind]
    for index in range(9):
        tiff = kind in ("floats", "pages of a TIFF")
        more = {"save_all": True, "append_images": [Image.new("L", (WIDTH, HEIGHT))]} if kind == "pages of a TIFF" else {}
        make(shoot.disk()).save(shoot.mask(index).with_suffix(".tif" if tiff else ".png"), **more)
        if tiff:
            shoot.mask(index).unlink()
    assert taken(shoot) > 0.92
    told = capsys.readouterr().err
    assert (f"9 of 9 masks are taken as {said}" in told) if said else ("masks are taken as" not in told)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_photos_of_the_object_on_black_are_masks_and_those_on_what_they_show_are_none(shoot, suffix, capsys):
    for index in range(9):
        photo = np.asarray(Image.open(shoot.image(index))) // 2 + 40
        shoot.mask(index).unlink()
        Image.fromarray(np.where(shoot.disk()[..., None], photo, 0)).save(shoot.mask(index).with_suffix(suffix))
    assert taken(shoot) > 0.95
    assert "9 of 9 masks are taken as photos of the object on black" in capsys.readouterr().err
    Image.fromarray(np.where(shoot.disk()[..., None], photo, photo // 3)).save(shoot.mask(3).with_suffix(suffix))
    with pytest.raises(StepError, match=rf"IMG_0003\{suffix} has the colours of a photo; make it white on the object"):
        taken(shoot)


@pytest.mark.parametrize(("on", "kind"), [(1, bool), (1, np.uint8), (255, np.uint8)])
def test_masks_are_arrays_of_numpy(shoot, on, kind):
    for index in range(9):
        shoot.mask(index).unlink()
        np.save(
            shoot.mask(index).with_suffix(".npy"), np.where(shoot.disk(), on, 0).astype(kind).reshape((HEIGHT, WIDTH, 1)[: 2 + index % 2])
        )
    assert taken(shoot) > 0.99


def test_arrays_of_other_shapes_and_broken_ones_are_named(shoot):
    np.save(shoot.mask(0).with_suffix(".npy"), np.zeros((1, HEIGHT, WIDTH)))
    shoot.mask(1).with_suffix(".npy").write_bytes(b"")
    for index in range(2):
        shoot.mask(index).unlink()
    message = shoot.refused()
    assert f"000.npy cannot be used (its shape is (1, {HEIGHT}, {WIDTH}), its type float64); save a (height, width) array" in message
    assert "001.npy cannot be used" in message


def test_dim_masks_that_were_compressed_are_taken(shoot, capsys):
    for index in range(9):
        shoot.mask(index).unlink()
        as_levels(0, 100)(shoot.disk()).save(shoot.masks / f"{shoot.image(index).stem}.jpg", quality=80)
    assert taken(shoot) > 0.97
    assert "9 of 9 masks are taken as grey, parted half way" in capsys.readouterr().err


@pytest.mark.parametrize("scale", [0.5, 1.6])
def test_masks_of_another_size_and_the_same_aspect_are_scaled(shoot, scale, capsys):
    for index in range(9):
        small = cv2.resize(shoot.disk().astype(np.uint8) * 255, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        write_mask(shoot.mask(index), small >= 128)
    assert taken(shoot) > 0.97
    assert f"scaled from {WIDTH * scale:g} x {HEIGHT * scale:g} px to the photo's size" in capsys.readouterr().err


def test_a_turned_photo_takes_a_mask_of_another_size_as_stored_or_as_shown(shoot):
    """Orientation 6, with a mask drawn on the shown photo at half its size."""
    for index in range(9):
        with Image.open(shoot.image(index)) as image:
            exif = image.getexif()
            exif[0x0112] = 6
            image.save(shoot.image(index), exif=exif)
        mask = shoot.disk(x=50)
        write_mask(shoot.mask(index), (np.rot90(mask, -1) if index % 2 else mask)[::2, ::2])
    shoot.take()
    for index in range(9):
        assert compute_overlap(read_mask(shoot.out / f"masks/{index:06d}.png"), np.rot90(shoot.disk(x=50), -1)) > 0.95


def test_which_way_a_mask_is_drawn_is_said_where_its_size_does_not_tell(shoot, capsys):
    """Orientation 3: the photo is turned upside down, and its mask as it is stored or as it is shown has one size."""
    with Image.open(shoot.image(2)) as image:
        exif = image.getexif()
        exif[0x0112] = 3
        image.save(shoot.image(2), exif=exif)
    write_mask(shoot.mask(2), shoot.disk(x=50))
    shoot.take()
    assert np.array_equal(read_mask(shoot.out / "masks/000002.png"), shoot.disk(x=50)[::-1, ::-1])
    assert "1 of 9 masks are taken as drawn on the photos before they are turned (EXIF orientation 3)" in capsys.readouterr().err


def test_masks_of_photos_on_their_side_tell_how_the_others_are_drawn(shoot, capsys):
    """Orientations 6 and 3, the masks drawn on the photos as they are shown; that of the second alone fits both ways."""
    shown = {2: shoot.disk(x=50), 4: np.rot90(shoot.disk(x=50), -1)}
    for index, orientation in ((2, 3), (4, 6)):
        with Image.open(shoot.image(index)) as image:
            exif = image.getexif()
            exif[0x0112] = orientation
            image.save(shoot.image(index), exif=exif)
        write_mask(shoot.mask(index), shown[index])
    shoot.take()
    for index, mask in shown.items():
        assert np.array_equal(read_mask(shoot.out / f"masks/{index:06d}.png"), mask)
    assert "before they are turned" not in capsys.readouterr().err


@pytest.mark.parametrize("spoil", [lambda disk: ~disk, lambda disk: ~disk & (np.arange(WIDTH) < WIDTH - 1)])
def test_inverted_masks_are_refused_at_once(shoot, spoil):
    for index in range(9):
        write_mask(shoot.mask(index), spoil(shoot.disk()))
    message = shoot.refused()
    assert "9 of 9 photos" in message and "white (255) on the object and black (0) elsewhere" in message and "invert" in message


def test_objects_that_are_cut_off_in_all_photos_are_no_inverted_masks(shoot, capsys):
    for index in range(9):
        write_mask(shoot.mask(index), shoot.disk(x=130, y=100) | (np.mgrid[:HEIGHT, :WIDTH][0] > 100))
    shoot.take()
    assert "cut off at the border in 9 of 9 images" in capsys.readouterr().err
