"""Judge photos or a film before anything long runs: can they be read, are they sharp, light and different enough, do they share enough?"""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from zeroshop_steps.capture.bridging import SHARED_FEATURES, Features, count_shared, find_features
from zeroshop_steps.capture.frames import (
    collect_image_warnings,
    look_alike,
    make_thumbnail,
    measure_edge_blur_px,
    measure_level,
    measure_sharpness,
)
from zeroshop_steps.capture.photo_files import list_photos, read_photo
from zeroshop_steps.capture.photos import MIN_IMAGES, MOST_IMAGES
from zeroshop_steps.capture.video import choose_frames, read_numbers, scan_video
from zeroshop_steps.geometry.view_similarity import count_common_features, describe_view
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track

ENOUGH_IMAGES = 20  # different ones; with fewer, a warning asks for more
FRAMES = 20  # of a film that are judged
PARTNERS = 3  # photos that each is compared with, those most like it
LONELY_SHARE = 0.25
"""Of the photos may share too little with any other: up to 0.16 where cameras came out right (bananas on a carpet, a kitchen table,
rendered captures), 0.4 and 0.65 where they came out folded and bent (20 and 30 frames on a white and a wooden table)."""
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
    features: list[Features] = []
    descriptors: list[np.ndarray] = []
    try:
        every = math.ceil(len(list_photos(source)[0]) / MOST_IMAGES) if source.is_dir() else 0
        for name, image in _read_folder(source) if source.is_dir() else _read_film(source):
            if image is None:
                unusable.append(name)
                continue
            names.append(name)
            sharpness.append(measure_sharpness(image))
            levels.append(measure_level(image))
            blurs_px.append(measure_edge_blur_px(image))
            thumbnail = make_thumbnail(image)
            if not any(look_alike(thumbnail, other) for other in distinct):
                distinct.append(thumbnail)
            if every and len(names) % every == 0:
                features.append(find_features(image))
                descriptors.append(describe_view(image))
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
    warnings += _warn_of_lonely(features, descriptors)
    if len(names) > MOST_IMAGES and source.is_dir():
        warnings.append(f"{len(names)} pictures; the {MOST_IMAGES} most useful ones are taken (photos.most_images)")
    return [], warnings


def _warn_of_lonely(features: list[Features], descriptors: list[np.ndarray]) -> list[str]:
    """A warning where many photos share too little with any other. Of a film, frames in between are taken instead."""
    if len(features) < MIN_IMAGES:
        return []
    common = count_common_features(descriptors)
    partners = np.argsort(-common, axis=1)[:, :PARTNERS]
    best = [max(count_shared(features[one], features[other]) for other in others) for one, others in enumerate(partners)]
    lonely = sum(shared < SHARED_FEATURES for shared in best)
    if lonely <= LONELY_SHARE * len(best):
        return []
    return [
        f"{lonely} of {len(best)} photos share so little with any other that their cameras may be wrong: put a newspaper or other print"
        " below the object, take photos in between, every 10 to 15 degrees, or film it: of a film, more views are taken where needed"
    ]


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
    chosen = choose_frames(scan_video(video), FRAMES)
    yield from ((f"frame {number}", frame) for number, frame in read_numbers(video, chosen))
