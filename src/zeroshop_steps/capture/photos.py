"""Check the user's own photos and masks and copy them into a capture folder; the originals are never changed.

Each photo has a mask with its name and .png, 255 on the object and 0 elsewhere, or a picture in which all but the object is transparent,
such as the photo itself. Other names and levels of other tools are taken, too, and told (`mask_names.py`, `mask_files.py`). Or no photo has
one, and a later step finds them.
Photos that cannot be used are left out and named, as long as enough are left; otherwise all problems are reported at once.
"""

import argparse
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.capture.cameras_json import FILE, read_given_cameras
from zeroshop_steps.capture.copies import Encoding, describe_encoding, find_twins, find_worse_copies
from zeroshop_steps.capture.frame_quality import (
    collect_image_warnings,
    draw_contact_sheet,
    look_alike,
    measure_edge_blur_px,
    measure_level,
    measure_sharpness,
    write_capture_record,
)
from zeroshop_steps.capture.mask_faults import check_polarity, find_mask_fault, is_cut_off
from zeroshop_steps.capture.mask_files import UserMask, are_drawn_upright, read_user_mask
from zeroshop_steps.capture.mask_names import MaskNames, find_masks, split_masks
from zeroshop_steps.capture.photo_files import MAX_SIDE_PX, choose_suffix, is_cut_out, list_photos, read_photo, write_upright
from zeroshop_steps.capture.selection import find_blurred, thin_out
from zeroshop_steps.geometry.imaging.image_overlap import count_common_features, describe_view
from zeroshop_steps.geometry.imaging.images import list_images, read_image, write_image, write_mask
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory

MIN_IMAGES = 8  # fewer show too little of an object from all sides
MOST_IMAGES = 60  # more show hardly anything new, and each costs seconds in every later step
MOST_LISTED = 12  # names or problems in a message


@dataclass(frozen=True)
class Photo:
    """A photo that could be read, with its mask.

    Attributes:
        path: the user's file.
        size_px: (width, height) as it is used: upright and reduced.
        mask: of its size; None where the capture has no masks.
        encoding: how it was saved, for comparing photos.
        descriptors: of a few features, for choosing among many photos; None where all are taken.
        sharpness, level, blur_px: as `frame_quality.collect_image_warnings` wants them.
    """

    path: Path
    size_px: tuple[int, int]
    mask: UserMask | None
    encoding: Encoding
    descriptors: np.ndarray | None
    sharpness: float
    level: float
    blur_px: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--images", type=Path, required=True, help="folder of photos: JPEG, PNG, HEIC, TIFF, WebP")
    parser.add_argument(
        "--masks",
        type=Path,
        help="folder of masks, each named like its photo, such as x.png, x.jpg.png or x_mask.png, or of photos with a transparent"
        " background; none when left out",
    )
    parser.add_argument("--cameras", type=Path, help=f"{FILE}: cameras that come with the photos; estimated when left out")
    parser.add_argument("--min-images", type=int, default=MIN_IMAGES, help="fewest photos that are accepted (default: %(default)s)")
    parser.add_argument("--most-images", type=int, default=MOST_IMAGES, help="most photos that are used (default: %(default)s)")
    parser.add_argument("--max-side-px", type=int, default=MAX_SIDE_PX, help="larger photos are scaled down (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    import_photos(args.images, args.masks, args.min_images, args.out, args.most_images, args.max_side_px, args.cameras)


def import_photos(
    images: Path,
    masks: Path | None,
    min_images: int,
    out: Path,
    most_images: int = MOST_IMAGES,
    max_side_px: int = MAX_SIDE_PX,
    cameras: Path | None = None,
) -> None:
    """Check photos and masks and copy them to `out` as images/000000.jpg, masks/000000.png and so on, in the order of their names.

    Cameras that come with them are written to cameras.json, for the photos as they are used.

    Photos may differ in size, orientation and camera. Left out, and named in a warning, are photos that cannot be read, whose mask
    is missing or wrong, that are copies of others, that are much more blurred than the others, and, of more than `most_images`, those
    that add least.
    Refused are fewer than `min_images` photos that are left, differ from each other, and show the whole object (its mask keeps off
    the border).

    Raises:
        StepError: with a line for every problem found.
    """
    start_s = time.monotonic()
    paths, odd = list_photos(images)
    paths, beside = split_masks(paths)
    problems = [f"photos in a format that cannot be read: {_join_names([path.name for path in odd])}; export them as JPEG"] if odd else []
    names = None if masks is None else find_masks(paths, Path(masks))
    warnings = _tell_masks(names, beside, images)
    photos, upright = [], names is not None and are_drawn_upright(names.found)
    for path in paths:
        try:
            photos.append(_read(path, names, Path(masks or images), max_side_px, len(paths) > most_images, upright))
        except StepError as error:
            problems.append(str(error))
    check_polarity([(photo.path.name, photo.mask) for photo in photos], Path(masks or images))
    kinds = Counter(photo.mask.kind for photo in photos if photo.mask and photo.mask.kind)
    warnings += [f"{count} of {len(photos)} masks are taken as {kind}" for kind, count in kinds.most_common(MOST_LISTED)]
    faults = {photo.path: fault for photo in photos if photo.mask and (fault := find_mask_fault(photo.mask))}
    problems += faults.values()
    photos = [photo for photo in photos if photo.path not in faults]
    if len(photos) < min_images:
        usable = f", {len(photos)} of them usable" if len(photos) < len(paths) else ""
        problems.append(f"{images} holds {len(paths)} image(s){usable}, at least {min_images} are needed: take more, all around the object")
        raise StepError(_join_problems(problems))
    warnings += [f"left out: {problem}" for problem in problems]
    photos, more = _leave_out(photos, min_images, most_images)
    warnings += more
    view_problems, more = _find_view_problems(photos, min_images)
    if view_problems:
        raise StepError(_join_problems(problems + view_problems))
    warnings += more
    for warning in warnings:
        warn(warning)
    _write(photos, max_side_px, out, {"photos_found": len(paths) + len(odd), "warnings": warnings}, start_s, cameras)


def _write(photos: list[Photo], max_side_px: int, out: Path, facts: dict, start_s: float, cameras: Path | None) -> None:
    with atomic_directory(out) as folder:
        if cameras is not None:
            names = {photo.path.name: f"{index:06d}{choose_suffix(photo.path)}" for index, photo in enumerate(photos)}
            given = read_given_cameras(cameras).for_photos(names, {photo.path.name: photo.size_px for photo in photos}, cameras)
            facts["warnings"] += given.warnings
            for line in given.warnings:
                warn(line)
            given.write(folder / FILE)
        (folder / "images").mkdir()
        for index, photo in enumerate(photos):
            write_upright(photo.path, folder / "images" / f"{index:06d}{choose_suffix(photo.path)}", max_side_px)
            if photo.mask is not None:
                write_mask(folder / "masks" / f"{index:06d}.png", photo.mask.pixels)
        sheet = draw_contact_sheet(map(read_image, list_images(folder / "images")), [photo.path.stem for photo in photos])
        write_image(folder / "contact_sheet.png", sheet)
        facts = {"source_names": [photo.path.name for photo in photos], **facts, "seconds": round(time.monotonic() - start_s, 2)}
        sizes = [photo.size_px for photo in photos]
        sharpnesses, levels = [photo.sharpness for photo in photos], [photo.level for photo in photos]
        write_capture_record(folder, sizes, sharpnesses, levels, [photo.blur_px for photo in photos], facts)


def _read(path: Path, names: MaskNames | None, masks: Path, max_side_px: int, describe: bool, upright: bool) -> Photo:
    photo = read_photo(path, max_side_px)
    image = photo.pixels
    mask = None
    if names is not None:
        if path not in names.found:
            raise StepError(f"image {path} has no mask: {names.expect(path, masks)}; draw one, 255 on the object and 0 elsewhere")
        mask = read_user_mask(names.found[path], path, photo, upright)
    descriptors = describe_view(image) if describe else None
    facts = (measure_sharpness(image), measure_level(image), measure_edge_blur_px(image))
    return Photo(path, photo.size_px, mask, describe_encoding(path, photo), descriptors, *facts)


def _tell_masks(names: MaskNames | None, beside: list[Path], images: Path) -> list[str]:
    """What is taken as masks, where it is not the usual."""
    if names is None:
        use = f"to use {'them' if beside else 'it as masks'}, name {images} as their folder"
        if beside:
            return [f"left out, masks among the photos: {_join_names([path.name for path in beside])}; {use}"]
        return [f"the background of the photos is transparent; {use}"] if is_cut_out(images) else []
    if not names.example:
        return []
    photo, mask = names.example
    more = f"; other masks, such as {names.unused}, are not used" if names.unused else ""
    return [f"masks are taken by their names: {mask} for {photo}, and all others alike{more}"]


def _leave_out(photos: list[Photo], min_images: int, most_images: int) -> tuple[list[Photo], list[str]]:
    """Without copies of photos and those that are much more blurred than the others, and at most `most_images`; warnings name these."""
    warnings = []
    copies = find_worse_copies([photo.encoding for photo in photos])
    if copies and len(photos) - len(copies) >= min_images:
        # Matches between copies do not move, as those of a background that stands still while the object turns.
        warnings.append(f"left out, copies of other photos: {_name_twins(photos, copies)}")
        photos = [photo for number, photo in enumerate(photos) if number not in copies]
    blurred = set(find_blurred([photo.sharpness for photo in photos], [photo.blur_px for photo in photos]))
    if blurred and len(photos) - len(blurred) >= min_images:
        names = _join_names([photos[number].path.name for number in sorted(blurred)])
        warnings.append(f"left out, blurred, much more than the others: {names}; hold the camera still, or move it more slowly")
        photos = [photo for number, photo in enumerate(photos) if number not in blurred]
    if len(photos) > most_images:
        common = count_common_features([photo.descriptors for photo in photos if photo.descriptors is not None])
        kept = set(thin_out(common, [photo.sharpness for photo in photos], most_images))
        names = _join_names([photo.path.name for number, photo in enumerate(photos) if number not in kept])
        warnings.append(
            f"left out: {len(photos) - most_images} of {len(photos)} photos that show what sharper ones show, too, for {most_images} are"
            f" enough (photos.most_images): {names}"
        )
        photos = [photo for number, photo in enumerate(photos) if number in kept]
    return photos, warnings


def _find_view_problems(photos: list[Photo], min_images: int) -> tuple[list[str], list[str]]:
    """Problems and warnings that only the set of photos shows: copies of one view, and the object cut off."""
    problems, warnings = [], []
    alike = find_twins([photo.encoding.thumbnail for photo in photos], look_alike)
    distinct = len(photos) - len(alike)
    if distinct < min_images:
        problems.append(
            f"images in {photos[0].path.parent} are alike: only {distinct} of {len(photos)} differ, {min_images} are needed;"
            f" move the camera around the object between photos. Alike: {_name_twins(photos, alike)}"
        )
    elif alike:
        warnings.append(f"images that add nothing: {_name_twins(photos, alike)}")
    names, sharpnesses = [photo.path.name for photo in photos], [photo.sharpness for photo in photos]
    warnings += collect_image_warnings(names, sharpnesses, [photo.level for photo in photos], [photo.blur_px for photo in photos])
    cut = [photo.path.name for photo in photos if photo.mask and is_cut_off(photo.mask.pixels)]
    if cut:
        missing = "; a part that no photo shows will be missing, step back to have all of it" if len(photos) - len(cut) < min_images else ""
        warnings.append(f"the object is cut off at the border in {len(cut)} of {len(photos)} images: {_join_names(cut)}{missing}")
    return problems, warnings


def _name_twins(photos: list[Photo], twins: dict[int, int]) -> str:
    return _join_names([f"{photos[number].path.name} (like {photos[twin].path.name})" for number, twin in twins.items()])


def _join_names(names: list[str]) -> str:
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return ", ".join(names[:MOST_LISTED]) + more


def _join_problems(problems: list[str]) -> str:
    if len(problems) == 1:
        return problems[0]
    lines = problems[:MOST_LISTED] + ([f"... and {len(problems) - MOST_LISTED} more"] if len(problems) > MOST_LISTED else [])
    return f"{len(problems)} problems with the photos:\n  " + "\n  ".join(lines)
