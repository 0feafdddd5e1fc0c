"""Judge photos or a film before anything long runs: can they be read, are they sharp, light and different enough?"""

from pathlib import Path

import numpy as np

from zeroshop_steps.capture.frames import collect_image_warnings, look_alike, make_thumbnail, measure_edge_blur_px, measure_sharpness
from zeroshop_steps.capture.photos import MIN_IMAGES, find_format_problems
from zeroshop_steps.capture.video import choose_frames, read_frames, scan_video
from zeroshop_steps.geometry.images import list_images, read_image
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track

ENOUGH_IMAGES = 20
FRAMES = 20


def check_capture(source: Path) -> tuple[list[str], list[str]]:
    """What prevents a mesh, and what makes it worse, in words; both empty for a good capture.

    Args:
        source: a video, or a folder of photos.

    Raises:
        StepError: the video cannot be read.
    """
    names, images, problems = _read(source)
    if problems:
        return problems, []
    sharpness, levels, blurs_px, thumbnails, sizes = [], [], [], [], []
    for name, image in zip(names, images, strict=True):
        if image is None:
            problems.append(f"{name} cannot be read; export it again as JPEG")
            continue
        sharpness.append(measure_sharpness(image))
        levels.append(float(image.mean()))
        blurs_px.append(measure_edge_blur_px(image))
        thumbnails.append(make_thumbnail(image))
        sizes.append((image.shape[1], image.shape[0]))
    distinct: list[np.ndarray] = []
    for thumbnail in thumbnails:
        if not any(look_alike(thumbnail, other) for other in distinct):
            distinct.append(thumbnail)
    warnings = collect_image_warnings([name for name in names][: len(levels)], sharpness, levels, blurs_px)
    if len(distinct) < MIN_IMAGES:
        problems.append(f"only {len(distinct)} pictures differ from each other, {MIN_IMAGES} are needed: move around the object")
    elif len(distinct) < ENOUGH_IMAGES:
        warnings.append(f"{len(distinct)} different pictures; {ENOUGH_IMAGES} to 30 from all around, in two rings, make a better mesh")
    if len(set(sizes)) > 1:
        shown = ", ".join(f"{width} x {height}" for width, height in sorted(set(sizes)))
        warnings.append(f"pictures of different sizes: {shown}")
    return problems, warnings


def _read(source: Path) -> tuple[list[str], list[np.ndarray | None], list[str]]:
    """Names and pictures of a capture, None for one that cannot be read, and what is wrong with all of it."""
    if source.is_dir():
        problems = find_format_problems(source)
        try:
            paths = [] if problems else list_images(source)
        except StepError as error:
            return [], [], [str(error)]
        pictures: list[np.ndarray | None] = []
        for path in track(paths, "checking the photos", len(paths)):
            try:
                pictures.append(read_image(path))
            except StepError:
                pictures.append(None)
        return [path.name for path in paths], pictures, problems
    film = scan_video(source)
    chosen = set(choose_frames(film, FRAMES))
    frames = [frame for index, frame in enumerate(read_frames(source)) if index in chosen]
    return [f"frame {index}" for index in sorted(chosen)], [*frames], []
