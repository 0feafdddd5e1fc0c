"""The user's own photos: good ones are copied as they are, bad ones are refused with the file's name and a remedy."""

import cv2
import numpy as np
import pytest
from PIL import Image

from helpers.shoot import HEIGHT, WIDTH, Shoot
from zeroshop_steps.capture.frame_quality import is_copy, make_thumbnail
from zeroshop_steps.capture.photos import import_photos
from zeroshop_steps.geometry.imaging.images import read_image, read_mask, write_image, write_mask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json


def test_good_photos_are_copied(shoot):
    shoot.take()
    facts = read_json(shoot.out / "capture.json")
    assert facts["scene"] == "video" and facts["images"] == 9
    assert facts["source_names"][3] == "IMG_0003.jpg"
    assert (shoot.out / "images" / "000003.jpg").read_bytes() == shoot.image(3).read_bytes()
    assert np.array_equal(read_mask(shoot.out / "masks" / "000003.png"), shoot.disk())


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_images(tmp_path, count):
    shoot = Shoot(tmp_path, count)
    shoot.masks.mkdir(exist_ok=True)
    message = shoot.refused()
    assert "photos" in message and ("holds no images" in message if count == 0 else f"{count} image(s), at least 8" in message)


def test_photos_one_folder_below_are_pointed_at(tmp_path):
    shoot = Shoot(tmp_path, 9)
    with pytest.raises(StepError, match=f"in masks and {shoot.images.name}: name the folder with the photos"):
        import_photos(shoot.images.parent, None, 8, shoot.out)


def test_missing_folders(shoot):
    with pytest.raises(StepError, match="nowhere does not exist"):
        import_photos(shoot.images.parent / "nowhere", shoot.masks, 8, shoot.out)
    with pytest.raises(StepError, match="mask folder .*nowhere does not exist"):
        import_photos(shoot.images, shoot.images.parent / "nowhere", 8, shoot.out)


def test_all_problems_come_at_once(shoot):
    shoot.image(0).write_bytes(b"not an image")
    shoot.image(1).write_bytes(b"")
    shoot.mask(2).unlink()
    write_mask(shoot.mask(3), np.zeros((HEIGHT, WIDTH), bool))
    write_mask(shoot.mask(4), np.ones((HEIGHT, WIDTH), bool))
    write_mask(shoot.mask(5), np.ones((HEIGHT // 2, WIDTH), bool))
    message = shoot.refused()
    assert "7 problems" in message and "9 image(s), 3 of them usable, at least 8 are needed" in message
    for index in (0, 1):
        assert f"{shoot.image(index)} cannot be read" in message
    assert f"{shoot.mask(2)} does not exist" in message
    assert f"{shoot.mask(3)} is empty" in message
    assert f"{shoot.mask(4)} is full" in message
    assert f"{shoot.mask(5)} is 160 x 60 px" in message


def test_a_few_bad_photos_are_left_out_and_named(shoot, capsys):
    shoot.image(0).write_bytes(shoot.image(0).read_bytes()[:900])
    shoot.take()
    facts = read_json(shoot.out / "capture.json")
    assert facts["images"] == 8 and facts["photos_found"] == 9 and facts["source_names"][0] == "IMG_0001.jpg"
    assert "left out: image" in capsys.readouterr().err and f"{shoot.image(0)} cannot be read" in facts["warnings"][0]


def test_a_raw_photo_beside_the_others_is_named(shoot, capsys):
    (shoot.images / "IMG_0001.dng").write_bytes(b"raw")
    shoot.take()
    assert "left out: photos in a format that cannot be read: IMG_0001.dng; export them as JPEG" in capsys.readouterr().err


def test_turned_mask_points_at_exif(shoot, capsys):
    write_mask(shoot.mask(2), shoot.disk().T)
    shoot.take()
    assert "left out: mask" in (told := capsys.readouterr().err) and "stored turned" in told


@pytest.mark.parametrize("shown", [False, True])
def test_the_mask_of_a_turned_photo_may_be_drawn_as_it_is_stored_or_shown(shoot, shown):
    with Image.open(shoot.image(2)) as image:
        exif = image.getexif()
        exif[0x0112] = 6
        image.save(shoot.image(2), exif=exif)
    upright = np.rot90(shoot.disk(x=50), -1)
    write_mask(shoot.mask(2), upright if shown else shoot.disk(x=50))
    shoot.take()
    assert np.array_equal(read_mask(shoot.out / "masks" / "000002.png"), upright)
    assert read_image(shoot.out / "images" / "000002.jpg").shape[:2] == upright.shape


def test_images_of_different_sizes_and_orientations(shoot):
    for index, size in ((6, (WIDTH // 2, HEIGHT // 2)), (4, (HEIGHT, WIDTH))):
        write_image(shoot.image(index), cv2.resize(cv2.imread(str(shoot.image(index))), size))
        write_mask(shoot.mask(index), cv2.resize(shoot.disk().astype(np.uint8), size) > 0)
    shoot.take()
    facts = read_json(shoot.out / "capture.json")
    assert facts["images"] == 9 and (facts["width_px"], facts["height_px"]) == (WIDTH, HEIGHT)
    assert facts["sizes_px"][4] == [HEIGHT, WIDTH] and facts["sizes_px"][6] == [WIDTH // 2, HEIGHT // 2]
    assert read_mask(shoot.out / "masks" / "000004.png").shape == (WIDTH, HEIGHT)


def test_large_photos_are_reduced_with_their_masks(shoot):
    import_photos(shoot.images, shoot.masks, 8, shoot.out, max_side_px=80)
    assert read_image(shoot.out / "images" / "000003.jpg").shape == (60, 80, 3)
    reduced = read_mask(shoot.out / "masks" / "000003.png")
    assert reduced.shape == (60, 80) and abs(reduced.mean() - shoot.disk().mean()) < 0.01


def test_too_many_photos_are_thinned_out(shoot, capsys):
    scene = np.random.default_rng(5).integers(0, 255, (40, 60, 3), dtype=np.uint8)
    scene = cv2.resize(scene, (960, 640), interpolation=cv2.INTER_CUBIC)
    for index in range(9):
        # A camera that moves on by a quarter of its picture each time; three photos are taken from nearly one place.
        left = 80 * min(index, 6) + 4 * max(index - 6, 0)
        write_image(shoot.image(index), scene[60 : 60 + 360, left : left + 480])
    write_image(shoot.image(7), cv2.GaussianBlur(scene[60 : 60 + 360, 484 : 484 + 480], (0, 0), 1.2))
    import_photos(shoot.images, None, 3, shoot.out, most_images=7)
    kept = read_json(shoot.out / "capture.json")["source_names"]
    assert len(kept) == 7 and "IMG_0007.jpg" not in kept
    assert {"IMG_0000.jpg", "IMG_0001.jpg", "IMG_0002.jpg", "IMG_0003.jpg"} < set(kept)
    assert "2 of 9 photos that show what sharper ones show" in capsys.readouterr().err


def test_images_all_alike(shoot):
    noise = np.random.default_rng(0)
    for index in range(9):
        write_image(shoot.image(index), np.clip(120 + noise.normal(0, 3, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8))
    message = shoot.refused()
    assert "only 1 of 9 differ" in message and "IMG_0008.jpg (like IMG_0000.jpg)" in message


def test_a_copy_is_left_out_and_told(shoot, capsys):
    shoot.image(4).write_bytes(shoot.image(3).read_bytes())
    shoot.take()
    assert "left out, copies of other photos: IMG_0004.jpg (like IMG_0003.jpg)" in capsys.readouterr().err
    names = read_json(shoot.out / "capture.json")["source_names"]
    assert "IMG_0003.jpg" in names and "IMG_0004.jpg" not in names and len(names) == 8


def test_a_photo_that_was_compressed_anew_is_a_copy():
    scene = cv2.resize(np.random.default_rng(5).integers(0, 255, (60, 80, 3), dtype=np.uint8), (1280, 960), interpolation=cv2.INTER_CUBIC)
    encoded = cv2.imencode(".jpg", scene, [cv2.IMWRITE_JPEG_QUALITY, 60])[1]
    one, again, moved = map(make_thumbnail, (scene, cv2.imdecode(encoded, cv2.IMREAD_COLOR), np.roll(scene, 2, axis=1)))
    assert is_copy(one, again) and not is_copy(one, moved)


@pytest.mark.parametrize("times", [1, 2])
def test_encodings_of_one_name_are_of_one_photo_however_much_they_differ(shoot, times, capsys):
    """One is lossless, and the other compressed, or enlarged besides."""
    pixels = cv2.GaussianBlur(read_image(shoot.image(3)), (0, 0), 1)
    write_image(shoot.images / "IMG_0003.png", pixels)
    Image.fromarray(pixels.repeat(times, 0).repeat(times, 1)).save(shoot.image(3), quality=70)
    shoot.take()
    assert "copies of other photos: IMG_0003.jpg (like IMG_0003.png)" in capsys.readouterr().err


@pytest.mark.parametrize(("scale", "quality"), [(0.5, 95), (1.0, 60)])
def test_of_two_encodings_the_better_one_stays(tmp_path, scale, quality, capsys):
    """The worse one comes first by name, and another one last."""
    shoot = Shoot(tmp_path, 9)
    rng = np.random.default_rng(5)
    blocks = cv2.resize(rng.integers(50, 200, (12, 16, 3), dtype=np.uint8), (640, 480), interpolation=cv2.INTER_NEAREST)
    scene = (blocks + rng.integers(-12, 13, (480, 640, 1))).astype(np.uint8)  # fine grain, which compression takes first
    write_image(shoot.images / "IMG_0003.png", scene)
    small = cv2.resize(scene, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for name in ("IMG_0002_sent.jpg", "IMG_0004_sent.jpg"):
        Image.fromarray(small).save(shoot.images / name, quality=quality)
    import_photos(shoot.images, None, 8, shoot.out)
    names = read_json(shoot.out / "capture.json")["source_names"]
    assert "IMG_0003.png" in names and not any("sent" in name for name in names)
    assert "IMG_0002_sent.jpg (like IMG_0003.png), IMG_0004_sent.jpg (like IMG_0003.png)" in capsys.readouterr().err


def test_copies_that_are_needed_are_refused_by_name(shoot):
    """Of eight photos at least, seven that differ are too few, and the reason says so."""
    for number in (4, 5):
        shoot.image(number).write_bytes(shoot.image(3).read_bytes())
    assert "only 7 of 9 differ" in shoot.refused()


def test_object_cut_off(shoot, capsys):
    write_mask(shoot.mask(7), shoot.disk(x=140))
    shoot.take()
    assert "cut off at the border in 1 of 9 images: IMG_0007.jpg" in capsys.readouterr().err
    for index in (2, 5):
        write_mask(shoot.mask(index), shoot.disk(y=5))
    shoot.out.rename(shoot.out.with_name("before"))
    shoot.take()
    warning = capsys.readouterr().err
    assert "3 of 9 images: IMG_0002.jpg, IMG_0005.jpg, IMG_0007.jpg; a part that no photo shows will be missing" in warning


def test_skull(shared_data, tmp_path):
    folder = shared_data / "dtu_scan65"
    import_photos(folder / "images", folder / "masks", 8, tmp_path / "capture")
    assert read_json(tmp_path / "capture" / "capture.json")["images"] == 25


def test_photos_without_masks(shoot):
    import_photos(shoot.images, None, 8, shoot.out)
    assert read_json(shoot.out / "capture.json")["images"] == 9
    assert not (shoot.out / "masks").exists()
    assert (shoot.out / "images" / "000003.jpg").read_bytes() == shoot.image(3).read_bytes()


def test_a_blurred_photo_is_left_out_and_told(shoot, capsys):
    write_image(shoot.image(5), cv2.GaussianBlur(cv2.imread(str(shoot.image(5))), (0, 0), 6))
    import_photos(shoot.images, None, 8, shoot.out)
    assert "left out, blurred, much more than the others: IMG_0005.jpg" in capsys.readouterr().err
    assert "IMG_0005.jpg" not in read_json(shoot.out / "capture.json")["source_names"]


def test_photos_that_are_all_blurred_are_told(shoot, capsys):
    for index in range(9):
        write_image(shoot.image(index), cv2.GaussianBlur(cv2.imread(str(shoot.image(index))), (0, 0), 3))
    import_photos(shoot.images, None, 8, shoot.out)
    assert "blurred throughout" in capsys.readouterr().err
