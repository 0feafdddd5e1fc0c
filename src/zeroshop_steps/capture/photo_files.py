"""Read photos of any usual format upright, at a bounded size and in bounded memory."""

import contextlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pi_heif import register_heif_opener
from PIL import ExifTags, Image, ImageOps
from PIL.JpegImagePlugin import JpegImageFile
from PIL.TiffImagePlugin import IFDRational

from zeroshop_steps.geometry.imaging.image_files import FORMATS, any_size, check_kind, check_size, list_folder
from zeroshop_steps.geometry.imaging.images import IMAGE_SUFFIXES, to_rgb
from zeroshop_steps.runtime.errors import StepError, remedy_for

CONVERTED_SUFFIXES = (".jfif", ".jpe", ".mpo", ".heic", ".heif", ".avif", ".webp", ".tif", ".tiff", ".bmp", ".gif")
"""Names and formats that Pillow and pi-heif read; they are renamed or converted, because later steps read PNG and JPEG alone."""
UNREADABLE_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".raw")
LOSSLESS_SUFFIXES = (".png", ".bmp")
MAX_SIDE_PX = 3072  # finer photos do not make a finer surface, which is estimated from images of 1000 px, and hardly a finer texture
MOST_PIXELS = 250_000_000
"""Phones take up to 200 megapixels. More is a panorama or a damaged header, and would need more than 1 GB of memory."""
FEWEST_LEVELS = 16  # of 256, that a photo of 16 bits must use: of 12 bits stored in 16, no pixel is brighter
UPRIGHT = 1
TRANSPOSED = (5, 6, 7, 8)  # orientations in which width and height change places
PIXEL_COUNTS = ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight
PIXEL_DENSITIES = ExifTags.Base.FocalPlaneXResolution, ExifTags.Base.FocalPlaneYResolution
"""EXIF tags that count a photo's pixels, and those on a unit of the sensor: they say where the focal length lies in pixels."""


@dataclass(frozen=True)
class PhotoPixels:
    """A photo as it is used.

    Attributes:
        pixels: (height, width, 3) uint8 RGB, upright.
        stored_px: (width, height) in the file, before it is turned or reduced.
        stored_as: its format, as Pillow calls it.
        orientation: how it is stored, as EXIF counts (1 is upright).
        exif: its tags, without the orientation, for its size as it is used.
        quantization: the 64 steps of a JPEG's brightness, row by row, in levels; none for other formats.
    """

    pixels: np.ndarray
    stored_px: tuple[int, int]
    stored_as: str
    orientation: int
    exif: Image.Exif
    quantization: tuple[int, ...]

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]


def list_photos(folder: Path) -> tuple[list[Path], list[Path]]:
    """The photos of a folder that can be read by their format, and those that cannot, sorted by name.

    Raises:
        StepError: the folder is missing, or holds no photos.
    """
    folder = Path(folder)
    files = list_folder(folder)
    photos = [path for path in files if path.suffix.lower() in (*IMAGE_SUFFIXES, *CONVERTED_SUFFIXES)]
    odd = [path for path in files if path.suffix.lower() in UNREADABLE_SUFFIXES]
    if not photos:
        more = f"; {odd[0].name} is in a format that cannot be read: export it as JPEG" if odd else ""
        below = [path.name for path in files if any(one.suffix.lower() in IMAGE_SUFFIXES for one in path.glob("*"))]
        more += f"; there are some one folder below, in {' and '.join(below)}: name the folder with the photos" if below else ""
        there = [path.name for path in files if path.is_file()][:3]
        more += (
            f"; it holds {', '.join(there)}: export pictures as JPEG, and name a film itself, not its folder" if there and not more else ""
        )
        raise StepError(f"{folder} holds no images; expected files ending in {', '.join((*IMAGE_SUFFIXES, *CONVERTED_SUFFIXES))}{more}")
    return photos, odd


def find_format_problems(folder: Path) -> list[str]:
    """Photos in formats that must be converted before a step reads them where they lie, in words."""
    if not Path(folder).is_dir():
        return []
    odd = sorted(path.name for path in Path(folder).iterdir() if path.suffix.lower() in (*CONVERTED_SUFFIXES, *UNREADABLE_SUFFIXES))
    return [f"{folder} holds photos that are neither JPEG nor PNG: {', '.join(odd)}; export them as JPEG"] if odd else []


def read_photo(path: Path, max_side_px: int) -> PhotoPixels:
    """Read a photo, turned upright as its EXIF says and reduced to `max_side_px` along its longer side.

    JPEG is decoded at a fraction of its size where that is enough, so that 200 megapixels need no more memory than 12.

    Raises:
        StepError: the file is empty, damaged, cut off, no image, or larger than `MOST_PIXELS`.
    """
    with open_picture(path) as image:
        stored_px, stored_as = image.size, str(image.format)
        quantization = tuple(next(iter(image.quantization.values()), ())) if isinstance(image, JpegImageFile) else ()
        check_size(path, stored_px)
        if stored_as in ("GIF", "WEBP") and getattr(image, "is_animated", False):
            raise StepError(f"image {path} is a film of {getattr(image, 'n_frames', 2)} pictures; give it alone, as GIF, or take it out")
        if image.mode == "F":
            raise StepError(
                f"image {path} has floating-point pixels, whose range of brightness it does not say; export it again as JPEG or PNG"
            )
        deep = any(";16" in str(part) for part in (image.mode, *getattr(image, "tile", ())))  # reading its tags decodes a PNG
        orientation = int(image.getexif().get(ExifTags.Base.Orientation, UPRIGHT))
        if max(stored_px) > max_side_px:
            image.draft("RGB", (max_side_px, max_side_px))
            image.thumbnail((max_side_px, max_side_px), Image.Resampling.LANCZOS, reducing_gap=2.0)
        upright = ImageOps.exif_transpose(image)
        exif = upright.getexif()
        _scale_pixel_tags(exif, max(upright.size) / max(stored_px))
        pixels = to_rgb(upright)
        if deep and pixels.max() < FEWEST_LEVELS:
            raise StepError(
                f"image {path} has 16 bits, of which its brightest pixel fills {8 + int(pixels.max()).bit_length()} at most: its camera"
                " measures 12 or fewer; multiply its levels, or export it as JPEG or PNG of 8 bits"
            )
        return PhotoPixels(pixels, stored_px, stored_as, orientation, exif, quantization)


@contextlib.contextmanager
def open_picture(path: Path) -> Iterator[Image.Image]:
    """Open a picture of any format that is read, of at most `MOST_PIXELS`.

    Raises:
        StepError: as `read_photo`, also for what is decoded within.
    """
    check_kind(path)
    register_heif_opener()
    try:
        with any_size(), Image.open(path) as image:  # its size is checked here, before anything is decoded
            if image.width * image.height > MOST_PIXELS:
                raise StepError(
                    f"image {path} has {image.width} x {image.height} px, more than {MOST_PIXELS // 10**6} megapixels; reduce it first"
                )
            yield image
    except PermissionError as error:
        raise StepError(f"image {path} cannot be read: {error.strerror}. {remedy_for(error)}") from None
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise StepError(
            f"image {path} cannot be read: it is empty, damaged, not an image or of a kind that is not read ({error}); export it again as"
            " JPEG or PNG"
        ) from None


def choose_suffix(path: Path) -> str:
    """The suffix under which a photo is used: .png where nothing was lost in its file, .jpg otherwise."""
    return ".png" if path.suffix.lower() in LOSSLESS_SUFFIXES else ".jpg"


def write_upright(source: Path, target: Path, max_side_px: int) -> None:
    """Copy a photo; one that is turned, too large or of another format is written anew, and keeps its other EXIF tags."""
    photo = read_photo(source, max_side_px)
    if photo.stored_as in FORMATS and photo.orientation == UPRIGHT and photo.size_px == photo.stored_px:
        shutil.copyfile(source, target)
    else:
        Image.fromarray(photo.pixels).save(target, quality=97, exif=photo.exif)


def read_cut_out(image: Image.Image) -> np.ndarray | None:
    """(H, W) bool, as stored: what is not transparent in a picture whose background was removed; None where nothing or all of it was."""
    if image.mode == "RGBX":  # a TIFF whose fourth channel is not named, as some programs write transparency
        opacity = image.getchannel("X")
    elif image.has_transparency_data:
        opacity = image.convert("RGBA").getchannel("A")
    else:
        return None
    opaque: np.ndarray = np.asarray(opacity) > np.asarray(opacity).max() / 2  # some programs write 1 of 255
    return None if opaque.all() or not opaque.any() else opaque


def is_cut_out(folder: Path) -> bool:
    """Whether the background of a folder's photos was removed, so that it is transparent, by a few of them."""
    paths, cut_outs = list_photos(folder)[0], []
    for path in paths[:: max(1, len(paths) // 8)]:
        with contextlib.suppress(StepError), open_picture(path) as image:  # what cannot be read is told where the photo is read
            cut_outs.append(read_cut_out(image) is not None)
    return bool(cut_outs) and all(cut_outs)


def turn_upright(mask: np.ndarray, orientation: int) -> np.ndarray:
    """An (H, W) mask of a photo's stored pixels, turned as the photo is."""
    image = Image.fromarray(mask.astype(np.uint8) * 255)
    image.getexif()[ExifTags.Base.Orientation] = orientation
    return np.asarray(ImageOps.exif_transpose(image)) > 0


def _scale_pixel_tags(exif: Image.Exif, scale: float) -> None:
    """Change the tags that count pixels in place, for a photo that was reduced to `scale` of its size."""
    details = exif.get_ifd(ExifTags.IFD.Exif)
    for tag in {*PIXEL_COUNTS, *PIXEL_DENSITIES} & set(details):
        try:
            value = float(details[tag]) * scale
        except (TypeError, ValueError, ZeroDivisionError):
            continue
        details[tag] = round(value) if tag in PIXEL_COUNTS else IFDRational(value)
