"""Photos with masks that are right: of rendered captures, and of folders."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from zeroshop_steps.capture.photo_files import list_photos
from zeroshop_steps.geometry.images import list_images
from zeroshop_steps.runtime.errors import StepError

HALVES = ("tune", "judge")


@dataclass(frozen=True)
class MaskedPhoto:
    """A photo, the file of its mask, which may be smaller, and the name of the capture that it is of."""

    capture: str
    photo: Path
    mask: Path


def choose_half(shown: str) -> str:
    """tune or judge, by a hash of the object's name: nobody chooses, and no object is in both."""
    return HALVES[hashlib.sha1(shown.encode()).digest()[0] % 2]


def find_rendered(folder: Path, half: str) -> list[MaskedPhoto]:
    """All photos of one half of the rendered captures below a folder, OBJECT_DIFFICULTY/capture with truth/masks.

    Raises:
        StepError: there are none, or a photo has no mask.
    """
    captures = sorted(path.parent for path in folder.glob("*/capture") if (path / "truth/masks").is_dir())
    chosen = [path for path in captures if choose_half(path.name.rpartition("_")[0]) == half]
    if not chosen:
        raise StepError(f"{folder} holds no rendered captures of the half {half}; expected OBJECT_DIFFICULTY/capture/truth/masks")
    return [one for path in chosen for one in pair_folders(path.name, path / "capture/images", path / "capture/truth/masks")]


def pair_folders(name: str, photos: Path, masks: Path) -> list[MaskedPhoto]:
    """The photos of a capture that have a mask, by their stems.

    Raises:
        StepError: a folder is missing or empty, or a mask belongs to no photo.
    """
    by_stem = {path.stem: path for path in list_photos(photos)[0]}
    files = list_images(masks)
    if unknown := [path.name for path in files if path.stem not in by_stem]:
        raise StepError(f"{masks}: no photo in {photos} belongs to {', '.join(unknown)}; name masks as their photos, but .png")
    return [MaskedPhoto(name, by_stem[path.stem], path) for path in files]
