"""Of one photo in several encodings the best one stays, whatever their names; photos that one camera took of nearly one view stay."""

import cv2
import numpy as np
import pytest
from PIL import Image

from helpers.shoot import Shoot
from zeroshop_steps.capture.photos import import_photos
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.files import read_json

ORIGINAL = "IMG_0003.jpg"
ENCODINGS = {
    "compressed.jpg": {"quality": 10},
    "worst.jpg": {"quality": 3},
    "enlarged.png": {"scale": 1.5},
    "enlarged.jpg": {"scale": 1.5, "quality": 80},
    "whatsapp.jpeg": {"quality": 70, "scale": 0.25},
    "web.webp": {"quality": 60, "scale": 0.5},
    "grey.jpg": {"quality": 95, "mode": "L"},
    "sent.png": {"scale": 0.5},
}


def draw_scene() -> np.ndarray:
    """(360, 480, 3) uint8: patches, faint to the right, and fine grain, which compression takes first."""
    rng = np.random.default_rng(5)
    patches = cv2.resize(rng.integers(50, 200, (12, 16, 3), dtype=np.uint8), (480, 360), interpolation=cv2.INTER_CUBIC)
    patches = 125 + (patches - 125.0) * np.linspace(1, 0.1, 480)[:, None]
    return np.clip(patches + rng.integers(-12, 13, (360, 480, 1)), 0, 255).astype(np.uint8)


def take(shoot: Shoot) -> list[str]:
    import_photos(shoot.images, None, 8, shoot.out)
    return list(read_json(shoot.out / "capture.json")["source_names"])


@pytest.mark.parametrize("name", ENCODINGS)
@pytest.mark.parametrize("first", [True, False])
def test_the_best_encoding_stays(tmp_path, name, first, capsys):
    shoot, scene, name = Shoot(tmp_path, 9), draw_scene(), f"{'A' if first else 'Z'}_{name}"
    Image.fromarray(scene).save(shoot.image(3), quality=92)
    how = dict(ENCODINGS[name[2:]])
    picture = Image.open(shoot.image(3)).convert(how.pop("mode", "RGB"))
    scale = how.pop("scale", 1.0)
    picture.resize((round(480 * scale), round(360 * scale)), Image.Resampling.LANCZOS).save(shoot.images / name, **how)
    names = take(shoot)
    assert ORIGINAL in names and name not in names
    assert f"copies of other photos: {name} (like {ORIGINAL})" in capsys.readouterr().err


def test_a_reduced_copy_lacks_what_is_sharp_in_a_blurred_photo(tmp_path, capsys):
    shoot, scene = Shoot(tmp_path, 9), draw_scene()
    photo = cv2.GaussianBlur(scene, (0, 0), 6)
    photo[200:280, 300:380] = scene[200:280, 300:380]
    Image.fromarray(photo).save(shoot.image(3), quality=92)
    Image.fromarray(photo).resize((320, 240), Image.Resampling.LANCZOS).save(shoot.images / "reduced.png")
    assert ORIGINAL in take(shoot)
    assert f"reduced.png (like {ORIGINAL})" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_a_thing_that_turned_is_another_photo(tmp_path, suffix):
    """Before a background that stands still, also where the other photo was saved in another way."""
    shoot, scene = Shoot(tmp_path, 9), draw_scene()
    for name, turned in ((ORIGINAL, scene), (f"IMG_0020.{suffix}", np.roll(scene, 60, axis=1))):
        picture = scene.copy()
        picture[200:260, 300:360] = turned[200:260, 300:360]
        write_image(shoot.images / name, picture)
    assert {ORIGINAL, f"IMG_0020.{suffix}"} <= set(take(shoot))
