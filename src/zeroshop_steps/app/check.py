"""Judge photos or a film before anything long runs: can they be read, are they sharp, light and different enough?"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from zeroshop_steps.capture.frames import collect_image_warnings, look_alike, make_thumbnail, measure_edge_blur_px, measure_sharpness
from zeroshop_steps.capture.photo_files import list_photos, read_photo
from zeroshop_steps.capture.photos import MIN_IMAGES, MOST_IMAGES
from zeroshop_steps.capture.video import choose_frames, read_frames, scan_video
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track

ENOUGH_IMAGES = 20  # different ones; with fewer, a warning asks for more
FRAMES = 20  # of a film that are judged
CHECKED_SIDE_PX = 1920  # longer photos are reduced to it: enough to see blur


def check_capture(source: Path) -> tuple[list[str], list[str]]:
    """What prevents a mesh, and what makes it worse, in words; both empty for a good capture.

    Args:
        source: a video, or a folder of photos.

    Raises:
        StepError: the video cannot be read.
    """
    names: list[str] = []
    unusable: list[str] = []
    sharpness, levels, blurs_px = [], [], []
    distinct: list[np.ndarray] = []
    try:
        for name, image in _read_folder(source) if source.is_dir() else _read_film(source):
            if image is None:
                unusable.append(name)
                continue
            names.append(name)
            sharpness.append(measure_sharpness(image))
            levels.append(float(image.mean()))
            blurs_px.append(measure_edge_blur_px(image))
            thumbnail = make_thumbnail(image)
            if not any(look_alike(thumbnail, other) for other in distinct):
                distinct.append(thumbnail)
    except StepError as error:
        if not source.is_dir():
            raise
        return [str(error)], []
    warnings = [f"left out, cannot be read: {', '.join(unusable)}; export them as JPEG"] if unusable else []
    warnings += collect_image_warnings(names, sharpness, levels, blurs_px) if names else []
    if len(distinct) < MIN_IMAGES:
        found = f"only {len(distinct)} pictures differ from each other"
        return [f"{found}, {MIN_IMAGES} are needed: move around the object"], warnings
    if len(distinct) < ENOUGH_IMAGES:
        warnings.append(f"{len(distinct)} different pictures; {ENOUGH_IMAGES} to 30 from all around, in two rings, make a better mesh")
    if len(names) > MOST_IMAGES and source.is_dir():
        warnings.append(f"{len(names)} pictures; the {MOST_IMAGES} most useful ones are taken (photos.most_images)")
    return [], warnings


def _read_folder(folder: Path) -> Iterator[tuple[str, np.ndarray | None]]:
    """Names and pictures of a folder, one at a time, reduced; None for one that cannot be read."""
    paths, odd = list_photos(folder)
    yield from ((path.name, None) for path in odd)
    for path in track(paths, "checking the photos", len(paths)):
        try:
            yield path.name, read_photo(path, CHECKED_SIDE_PX).pixels
        except StepError:
            yield path.name, None


def _read_film(video: Path) -> Iterator[tuple[str, np.ndarray | None]]:
    chosen = set(choose_frames(scan_video(video), FRAMES))
    yield from ((f"frame {number}", frame) for number, frame in enumerate(read_frames(video)) if number in chosen)
