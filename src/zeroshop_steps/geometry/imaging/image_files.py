"""Which files can be photos: seen from their names and first bytes, before anything reads all of them."""

import contextlib
import os
import warnings
from collections.abc import Iterator
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from zeroshop_steps.runtime.errors import StepError, remedy_for
from zeroshop_steps.runtime.files import GIT_LFS_POINTER

FORMATS = ("JPEG", "PNG", "MPO")
"""As Pillow calls them; MPO is a JPEG with further pictures behind the first, as phones write it."""
LEAST_SIDE_PX = 32
"""Of a photo: SIFT needs some room around a feature, and COLMAP ends without a word on 20 x 15 px."""


def list_folder(folder: Path) -> list[Path]:
    """What lies in a folder of images, sorted by name, without hidden files.

    Raises:
        StepError: it is missing, a file, or may not be read.
    """
    check_folder(folder, "image folder", "check the path")
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise StepError(f"image folder {folder} cannot be read: {error.strerror}. {remedy_for(error)}") from None


def check_folder(folder: Path, what: str, remedy: str) -> None:
    """Raise StepError where a folder is a file, such as an archive, or does not exist."""
    if folder.is_file():
        raise StepError(f"{what} {folder} is a file, not a folder; unpack it, if it is an archive, and name the folder with the pictures")
    if not folder.is_dir():
        raise StepError(f"{what} {folder} does not exist; {remedy}")


def check_photo_file(path: Path) -> None:
    """Check the name, the kind and the first bytes of a photo's file.

    Whether all of it can be decoded shows only when it is read.

    Raises:
        StepError: a name that is not UTF-8, no file, one that may not be read, another format than its name says, or a photo
            that is too small or too large.
    """
    check_kind(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path) as image:
                image_format, (width_px, height_px) = image.format, image.size
    except Image.DecompressionBombError:
        most = 2 * (Image.MAX_IMAGE_PIXELS or 0) / 1e6
        raise StepError(f"image {path} has more than {most:.0f} megapixels; export it at half the size") from None
    except UnidentifiedImageError:
        return
    except OSError as error:
        raise StepError(f"image {path} cannot be read: {error.strerror or error}. {remedy_for(error)}") from None
    if image_format not in FORMATS:
        raise StepError(f"image {path} is named {path.suffix}, but holds {image_format}; export it as JPEG or PNG")
    check_size(path, (width_px, height_px))


def read_size_px(path: Path) -> tuple[int, int]:
    """The (width, height) of an image, from its header. Raises StepError where it is none."""
    try:
        with Image.open(path) as image:
            return image.size
    except (OSError, Image.DecompressionBombError) as error:
        raise StepError(f"image {path} cannot be read: it is empty, damaged or not an image ({error}); export it again") from None


@contextlib.contextmanager
def any_size() -> Iterator[None]:
    """Have Pillow open pictures of more than 89 megapixels, which it takes for an attack."""
    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        yield
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def check_size(path: Path, size_px: tuple[int, int]) -> None:
    """Raise StepError where a photo's (width, height) is too small for features."""
    if min(size_px) < LEAST_SIDE_PX:
        raise StepError(
            f"image {path} is {size_px[0]} x {size_px[1]} px; at least {LEAST_SIDE_PX} px are needed on each side, and 1000 work well:"
            " take the photo as the camera stored it"
        )


def check_kind(path: Path, what: str = "photo") -> None:
    """Raise StepError where a path is no file, its name is no text, or it only points to the picture, which is such a thing."""
    check_name(path)
    if not path.is_file():
        kind = "a folder" if path.is_dir() else "a link that leads nowhere" if path.is_symlink() else "no file"
        raise StepError(f"{path} is {kind}, not a {what}; remove it, or put the {what} itself there")
    with contextlib.suppress(OSError), path.open("rb") as file:  # what may not be read is told where it is decoded
        if file.read(32).startswith(GIT_LFS_POINTER):
            raise StepError(f"{path} is a pointer of Git LFS, not a {what}; fetch the {what} itself by git lfs pull")


def is_text(name: str) -> bool:
    """Whether a file's name is UTF-8."""
    try:
        os.fsencode(name).decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def check_name(path: Path) -> None:
    """Raise StepError where a file's name is not UTF-8: neither records nor other libraries could name it."""
    if not is_text(path.name):
        shown = os.fsencode(path.name).decode("utf-8", "backslashreplace")
        raise StepError(f"the name of {path.parent / shown} is not UTF-8 text; rename it with plain letters and digits")
