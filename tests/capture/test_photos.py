"""The user's own photos: good ones are copied as they are, bad ones are refused with the file's name and a remedy."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from zeroshop_steps.capture.photos import import_photos
from zeroshop_steps.geometry.images import read_mask, write_image, write_mask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

WIDTH, HEIGHT = 160, 120


class Shoot:
    """A folder of photos and one of masks that a test can spoil."""

    def __init__(self, root: Path, count: int) -> None:
        self.images, self.masks, self.out = root / "photos", root / "masks", root / "capture"
        self.images.mkdir()
        for index in range(count):
            rng = np.random.default_rng(index)
            blocks = rng.integers(0, 255, (HEIGHT // 10, WIDTH // 10, 3), dtype=np.uint8)
            write_image(self.image(index), cv2.resize(blocks, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST))
            write_mask(self.mask(index), self.disk())

    def image(self, index: int) -> Path:
        return self.images / f"IMG_{index:04d}.jpg"

    def mask(self, index: int) -> Path:
        return self.masks / f"IMG_{index:04d}.png"

    @staticmethod
    def disk(x: int = 80, y: int = 60) -> np.ndarray:
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        return (columns - x) ** 2 + (rows - y) ** 2 < 40**2

    def take(self, min_images: int = 8) -> None:
        import_photos(self.images, self.masks, min_images, self.out)

    def refused(self, **options) -> str:
        """The message of the error; nothing may be left behind, and the originals must be untouched."""
        before = {path: path.read_bytes() for folder in (self.images, self.masks) for path in folder.iterdir()}
        with pytest.raises(StepError) as error:
            self.take(**options)
        assert not self.out.exists() and not list(self.out.parent.glob(".capture*"))
        assert before == {path: path.read_bytes() for folder in (self.images, self.masks) for path in folder.iterdir()}
        return str(error.value)


@pytest.fixture
def shoot(tmp_path) -> Shoot:
    return Shoot(tmp_path, 9)


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
    assert "6 problems" in message
    for index in (0, 1):
        assert f"{shoot.image(index)} cannot be read" in message
    assert f"{shoot.mask(2)} does not exist" in message
    assert f"{shoot.mask(3)} is empty" in message
    assert f"{shoot.mask(4)} is full" in message
    assert f"{shoot.mask(5)} is 160 x 60 px" in message


def test_turned_mask_points_at_exif(shoot):
    write_mask(shoot.mask(2), shoot.disk().T)
    assert "EXIF" in shoot.refused()


def test_images_of_different_sizes(shoot):
    write_image(shoot.image(6), np.zeros((HEIGHT, WIDTH // 2, 3), np.uint8))
    write_mask(shoot.mask(6), shoot.disk()[:, 40:120])
    message = shoot.refused()
    assert "different sizes" in message and "IMG_0006.jpg (80 x 120)" in message


def test_images_all_alike(shoot):
    noise = np.random.default_rng(0)
    for index in range(9):
        write_image(shoot.image(index), np.clip(120 + noise.normal(0, 3, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8))
    message = shoot.refused()
    assert "only 1 of 9 differ" in message and "IMG_0008.jpg (like IMG_0000.jpg)" in message


def test_one_copy_is_only_a_warning(shoot, capsys):
    shoot.image(4).write_bytes(shoot.image(3).read_bytes())
    shoot.take()
    assert "IMG_0004.jpg (like IMG_0003.jpg)" in capsys.readouterr().err


def test_object_cut_off(shoot, capsys):
    write_mask(shoot.mask(7), shoot.disk(x=140))
    shoot.take()
    assert "cut off at the border in 1 of 9 images: IMG_0007.jpg" in capsys.readouterr().err
    for index in (2, 5):
        write_mask(shoot.mask(index), shoot.disk(y=5))
    shoot.out.rename(shoot.out.with_name("before"))
    message = shoot.refused()
    assert "3 of 9 images, 8 must show all of it" in message and "IMG_0002.jpg, IMG_0005.jpg, IMG_0007.jpg" in message


def test_skull(shared_data, tmp_path):
    folder = shared_data / "dtu_scan65"
    import_photos(folder / "images", folder / "masks", 8, tmp_path / "capture")
    assert read_json(tmp_path / "capture" / "capture.json")["images"] == 25


def test_photos_without_masks(shoot):
    import_photos(shoot.images, None, 8, shoot.out)
    assert read_json(shoot.out / "capture.json")["images"] == 9
    assert not (shoot.out / "masks").exists()
    assert (shoot.out / "images" / "000003.jpg").read_bytes() == shoot.image(3).read_bytes()


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


def test_portrait_and_landscape_mixed(shoot):
    with Image.open(shoot.image(4)) as image:
        image.transpose(Image.Transpose.ROTATE_90).save(shoot.image(4))
    with pytest.raises(StepError, match=r"different sizes.*IMG_0004.jpg \(120 x 160\)"):
        import_photos(shoot.images, None, 8, shoot.out)


def test_heic_photos_are_refused(shoot):
    shoot.image(2).rename(shoot.images / "IMG_0002.HEIC")
    with pytest.raises(StepError, match="format that cannot be read: IMG_0002.HEIC; export them as JPEG"):
        import_photos(shoot.images, None, 8, shoot.out)


def test_a_blurred_photo_is_told(shoot, capsys):
    write_image(shoot.image(5), cv2.GaussianBlur(cv2.imread(str(shoot.image(5))), (0, 0), 6))
    import_photos(shoot.images, None, 8, shoot.out)
    assert "blurred, much more than the others: IMG_0005.jpg" in capsys.readouterr().err


def test_photos_that_are_all_blurred_are_told(shoot, capsys):
    for index in range(9):
        write_image(shoot.image(index), cv2.GaussianBlur(cv2.imread(str(shoot.image(index))), (0, 0), 3))
    import_photos(shoot.images, None, 8, shoot.out)
    assert "blurred throughout" in capsys.readouterr().err
