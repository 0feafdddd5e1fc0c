"""Check the user's own photos and masks and copy them into a capture folder; the originals are never changed.

Each photo has a mask with its name and .png, 255 on the object and 0 elsewhere; or no photo has one, and a later step finds them.
All problems of all files are reported at once.
"""

import argparse
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from zeroshop_steps.capture.frames import (
    collect_image_warnings,
    draw_contact_sheet,
    look_alike,
    make_thumbnail,
    measure_edge_blur_px,
    measure_sharpness,
    write_capture_record,
)
from zeroshop_steps.geometry.images import list_images, read_image, read_mask, write_image, write_mask
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory

MIN_IMAGES = 8  # fewer show too little of an object from all sides
SMALLEST_SHARE, LARGEST_SHARE = 5e-4, 0.98  # of the image that a mask may cover; others are empty or full
MOST_LISTED = 12  # names or problems in a message
BORDER_SHARE, BORDER_PX = 0.005, 3  # of the image's circumference, and at least so many pixels, that a mask must touch to be cut off
UNREADABLE_SUFFIXES = (".heic", ".heif", ".avif", ".webp", ".tif", ".tiff", ".bmp", ".gif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raw")
ORIENTATION_TAG, UPRIGHT = 0x0112, 1


@dataclass(frozen=True)
class Photo:
    """A photo that could be read, with its mask.

    Attributes:
        path: the user's file.
        size_px: (width, height).
        mask: (height, width) bool; None where the capture has no masks.
        thumbnail: small float32 grey picture, for comparing photos.
        sharpness, level, blur_px: as `frames.collect_image_warnings` wants them.
        turned: whether the file records a rotation, which is applied unless there are masks.
    """

    path: Path
    size_px: tuple[int, int]
    mask: np.ndarray | None
    thumbnail: np.ndarray
    sharpness: float
    level: float
    blur_px: float
    turned: bool


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--images", type=Path, required=True, help="folder of PNG or JPEG photos, all of one size")
    parser.add_argument("--masks", type=Path, help="folder of masks, each named like its photo, but .png; none when left out")
    parser.add_argument("--min-images", type=int, default=MIN_IMAGES, help=f"fewest photos that are accepted (default {MIN_IMAGES})")
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    import_photos(args.images, args.masks, args.min_images, args.out)


def import_photos(images: Path, masks: Path | None, min_images: int, out: Path) -> None:
    """Check photos and masks and copy them to `out` as images/000000.jpg, masks/000000.png and so on, in the order of their names.

    Refused besides unreadable, missing and mismatched files: fewer than `min_images` photos, or photos that differ from each
    other, or photos that show the whole object (its mask keeps off the border). Further photos
    that cut the object off only lead to a warning: other photos show the rest.

    Raises:
        StepError: with a line for every problem found.
    """
    start_s = time.monotonic()
    problems = find_format_problems(images)
    paths = [] if problems else list_images(images)
    if masks is not None and not Path(masks).is_dir():
        raise StepError(f"mask folder {masks} does not exist; give one mask a photo, named like it but .png")
    photos = []
    for path in paths:
        try:
            photos.append(_read(path, None if masks is None else Path(masks)))
        except StepError as error:
            problems.append(str(error))
    problems += _find_size_problems(photos)
    if paths and len(paths) < min_images:
        problems.append(f"{images} holds {len(paths)} image(s), at least {min_images} are needed: take more, all around the object")
    warnings: list[str] = []
    if not problems:
        problems, warnings = _find_view_problems(photos, min_images)
    if problems:
        raise StepError(_join_problems(problems))
    for warning in warnings:
        warn(warning)
    with atomic_directory(out) as folder:
        (folder / "images").mkdir()
        for index, photo in enumerate(photos):
            suffix = ".png" if photo.path.suffix.lower() == ".png" else ".jpg"
            _copy_upright(photo, folder / "images" / f"{index:06d}{suffix}")
            if photo.mask is not None:
                write_mask(folder / "masks" / f"{index:06d}.png", photo.mask)
        sheet = draw_contact_sheet(map(read_image, list_images(folder / "images")), [photo.path.stem for photo in photos])
        write_image(folder / "contact_sheet.png", sheet)
        facts = {
            "source_names": [photo.path.name for photo in photos],
            "warnings": warnings,
            "seconds": round(time.monotonic() - start_s, 2),
        }
        sharpnesses, levels = [photo.sharpness for photo in photos], [photo.level for photo in photos]
        write_capture_record(folder, photos[0].size_px, sharpnesses, levels, [photo.blur_px for photo in photos], facts)


def find_format_problems(images: Path) -> list[str]:
    """Photos in formats that nothing here reads, in words."""
    if not Path(images).is_dir():
        return []
    odd = sorted(path.name for path in Path(images).iterdir() if path.suffix.lower() in UNREADABLE_SUFFIXES)
    return [f"{images} holds photos in a format that cannot be read: {_join_names(odd)}; export them as JPEG"] if odd else []


def _copy_upright(photo: Photo, target: Path) -> None:
    """Copy a photo; one that is stored turned, and has no mask of that shape, is turned upright and keeps its other EXIF tags."""
    if not photo.turned or photo.mask is not None:
        shutil.copyfile(photo.path, target)
        return
    with Image.open(photo.path) as image:
        upright = ImageOps.exif_transpose(image)
        upright.save(target, quality=97, exif=upright.getexif())


def _is_turned(path: Path) -> bool:
    with Image.open(path) as image:
        return image.getexif().get(ORIENTATION_TAG, UPRIGHT) != UPRIGHT


def _read_upright_size_px(path: Path) -> tuple[int, int]:
    with Image.open(path) as image:
        return ImageOps.exif_transpose(image).size


def _read(path: Path, masks: Path | None) -> Photo:
    image = read_image(path)
    height, width = image.shape[:2]
    turned = _is_turned(path)
    facts = (make_thumbnail(image), measure_sharpness(image), float(image.mean()), measure_edge_blur_px(image), turned)
    if masks is None:
        return Photo(path, _read_upright_size_px(path) if turned else (width, height), None, *facts)
    candidates = [masks / f"{path.stem}.png", masks / f"{path.name}.png"]
    mask_path = next((candidate for candidate in candidates if candidate.is_file()), None)
    if mask_path is None:
        raise StepError(f"image {path} has no mask: {candidates[0]} does not exist; draw one, 255 on the object and 0 elsewhere")
    mask = read_mask(mask_path)
    if mask.shape != (height, width):
        hint = " (the photo is stored turned: remove its EXIF rotation by exporting it again)" if mask.shape == (width, height) else ""
        raise StepError(
            f"mask {mask_path} is {mask.shape[1]} x {mask.shape[0]} px, its image {path.name} is {width} x {height} px;"
            f" they must be equal{hint}"
        )
    share = float(mask.mean())
    if share < SMALLEST_SHARE:
        raise StepError(f"mask {mask_path} is {'empty' if share == 0 else 'almost empty'}: mark the object with 255, or take the photo out")
    if share > LARGEST_SHARE:
        raise StepError(f"mask {mask_path} is full: {share:.0%} of the image is marked. Mark only the object; it must fit into the photo.")
    return Photo(path, (width, height), mask, *facts)


def _find_size_problems(photos: list[Photo]) -> list[str]:
    sizes = [photo.size_px for photo in photos]
    if len(set(sizes)) <= 1:
        return []
    usual = max(sorted(set(sizes)), key=sizes.count)
    odd = [f"{photo.path.name} ({photo.size_px[0]} x {photo.size_px[1]})" for photo in photos if photo.size_px != usual]
    return [
        f"images of different sizes: most are {usual[0]} x {usual[1]} px, but not {_join_names(odd)};"
        " take all with one camera, held the same way"
    ]


def _find_view_problems(photos: list[Photo], min_images: int) -> tuple[list[str], list[str]]:
    """Problems and warnings that only the set of photos shows: copies of one view, and the object cut off."""
    problems, warnings = [], []
    distinct: list[Photo] = []
    copies = []
    for photo in photos:
        twin = next((other for other in distinct if look_alike(photo.thumbnail, other.thumbnail)), None)
        if twin is None:
            distinct.append(photo)
        else:
            copies.append(f"{photo.path.name} (like {twin.path.name})")
    if len(distinct) < min_images:
        problems.append(
            f"images in {photos[0].path.parent} are alike: only {len(distinct)} of {len(photos)} differ, {min_images} are needed;"
            f" move the camera around the object between photos. Alike: {_join_names(copies)}"
        )
    elif copies:
        warnings.append(f"images that add nothing: {_join_names(copies)}")
    names, sharpnesses = [photo.path.name for photo in photos], [photo.sharpness for photo in photos]
    warnings += collect_image_warnings(names, sharpnesses, [photo.level for photo in photos], [photo.blur_px for photo in photos])
    cut = [photo.path.name for photo in photos if photo.mask is not None and _touches_border(photo.mask)]
    if len(photos) - len(cut) < min_images:
        problems.append(
            f"the object is cut off at the border in {len(cut)} of {len(photos)} images, {min_images} must show all of it;"
            f" step back, or correct the masks: {_join_names(cut)}"
        )
    elif cut:
        warnings.append(f"the object is cut off at the border in {len(cut)} of {len(photos)} images: {_join_names(cut)}")
    return problems, warnings


def _touches_border(mask: np.ndarray) -> bool:
    """Whether a mask touches so much of the image's border that the object is cut off there."""
    touching = int(mask[0].sum() + mask[-1].sum() + mask[:, 0].sum() + mask[:, -1].sum())
    return touching > max(BORDER_PX, BORDER_SHARE * 2 * sum(mask.shape))


def _join_names(names: list[str]) -> str:
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return ", ".join(names[:MOST_LISTED]) + more


def _join_problems(problems: list[str]) -> str:
    if len(problems) == 1:
        return problems[0]
    lines = problems[:MOST_LISTED] + ([f"... and {len(problems) - MOST_LISTED} more"] if len(problems) > MOST_LISTED else [])
    return f"{len(problems)} problems with the photos:\n  " + "\n  ".join(lines)
