"""Extract frames from a video of the object: the first, then the sharpest of each stretch of the path; more where they share little.

In all stretches the image changes by the same amount, whatever time they take: a camera at rest shows nothing new. The rotation
that the file records is applied. The original is never changed.
"""

import argparse
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import ImageSequence

from zeroshop_steps.capture.bridging import bridge_gaps
from zeroshop_steps.capture.frame_quality import (
    collect_image_warnings,
    draw_contact_sheet,
    look_alike,
    make_thumbnail,
    measure_edge_blur_px,
    measure_level,
    measure_sharpness,
    shrink_to_grey,
    write_capture_record,
)
from zeroshop_steps.capture.photo_files import open_picture
from zeroshop_steps.geometry.cameras.registered_views import space_evenly
from zeroshop_steps.geometry.imaging.image_files import check_kind
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory

VIDEO_SUFFIXES = (
    *(".mp4", ".mov", ".mkv", ".avi", ".m4v", ".webm", ".3gp", ".3g2", ".mts", ".m2ts", ".ts", ".mpg", ".mpeg"),
    *(".wmv", ".flv", ".ogv", ".qt", ".lrv", ".gif"),
)
FRAMES, MIN_FRAMES, MOST_FRAMES = 20, 8, 60
MAX_SIDE_PX = 1920
SPACINGS = ("view", "time")
"""By how much the view changes, the sharpest frame of each stretch; or by time, from the first frame to the last, sharp or not."""
WINDOW_SHARE = 0.35  # of a stretch, to either side of its middle: where its sharpest frame is looked for
READABLE_SHARE = 0.9  # of the frames that the file promises; with fewer, it is damaged
SPARE_FRAMES, SPARE_SHARE = 3, 0.01  # that players miss in silence, too: containers count frames that are cut off, or shown by none
STILL_CHANGE = 0.012  # of the image from one frame to the next, by noise alone
CUT_RATIO, CUT_CHANGE = 4.0, 0.25
"""A film goes on elsewhere where the image changes so many times as much as between frames of a moving camera, in the median, and by so
much: a phone's frames change by 0.02 to 0.1, pictures of other places by 0.7 and more."""
MOVING_FRAMES = 2  # while the camera moves, for each frame that is taken; with fewer, there is no choice of sharp ones
BLURRED_SHARE = 0.5  # of the sharpness of the film's best frames


@dataclass(frozen=True)
class VideoScan:
    """Measures of all frames of a video.

    Attributes:
        sharpnesses, levels: (F,) of every frame.
        changes: (F,) mean change of the picture since the frame before, in standard deviations of its grey; 0 for the first.
        thumbnails: (F, 48, 64) float32.
    """

    sharpnesses: np.ndarray
    levels: np.ndarray
    changes: np.ndarray
    thumbnails: np.ndarray

    @property
    def way(self) -> np.ndarray:
        """(F,) how much the picture has changed since the film began, noise apart."""
        return np.cumsum(np.maximum(self.changes - STILL_CHANGE, 0.0))

    @property
    def cuts(self) -> np.ndarray:
        """Numbers of the frames with which the film goes on elsewhere: it was put together of several."""
        moving = self.changes[self.changes > STILL_CHANGE]
        usual = float(np.median(moving)) if len(moving) else 0.0
        return np.flatnonzero(self.changes > max(CUT_RATIO * usual, CUT_CHANGE))

    def find_between(self, one: int, other: int) -> int | None:
        """The sharpest frame near the middle of the way between two; None where none differs from both."""
        way = self.way
        near = np.abs(way - (way[one] + way[other]) / 2)[one + 1 : other]
        if not len(near):
            return None
        candidates = one + 1 + np.flatnonzero(near <= max(WINDOW_SHARE * (way[other] - way[one]) / 2, near.min()))
        best = int(candidates[self.sharpnesses[candidates].argmax()])
        return None if any(look_alike(self.thumbnails[best], self.thumbnails[end]) for end in (one, other)) else best


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--images", type=Path, required=True, help=f"video file: {', '.join(VIDEO_SUFFIXES)}")
    parser.add_argument("--frames", type=int, default=FRAMES, help="frames to take (default: %(default)s)")
    parser.add_argument(
        "--most-frames", type=int, default=MOST_FRAMES, help="with those between frames that share too little (default: %(default)s)"
    )
    parser.add_argument("--spacing", choices=SPACINGS, default="view", help="what lies between frames is equal in (default: %(default)s)")
    parser.add_argument("--max-side-px", type=int, default=MAX_SIDE_PX, help="larger frames are scaled down (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    extract_frames(args.images, args.frames, args.max_side_px, args.out, args.most_frames, args.spacing)


def extract_frames(video: Path, count: int, max_side_px: int, out: Path, most: int = 0, spacing: str = "view") -> None:
    """Write frames to `out`/images, a picture of them all, and what to film again to capture.json.

    Args:
        video: the file.
        count: frames to take.
        max_side_px: larger frames are scaled down.
        out: folder to write.
        most: frames with those between frames that share too little to be registered together.
        spacing: one of `SPACINGS`.

    Raises:
        StepError: no video, a damaged or cut-off one, or one in which the camera hardly moves.
    """
    start_s = time.monotonic()
    film = scan_video(video)
    first = choose_frames(film, count) if spacing == "view" else space_evenly(len(film.changes), count)
    chosen = bridge_gaps(lambda numbers: read_numbers(video, numbers), first, film.find_between, most)
    needed = min(MIN_FRAMES, count)
    if len(chosen) < needed:
        raise StepError(f"{video} shows only {len(chosen)} different views, {needed} are needed: move the camera all around the object")
    # One at a time: sixty frames of 4K take 1.5 GB.
    scaled, blurs_px = [], []
    for _, frame in read_numbers(video, chosen):
        blurs_px.append(measure_edge_blur_px(frame))
        scaled.append(_shrink(frame, max_side_px))
    names = [f"{index:06d}" for index in range(len(chosen))]
    warnings = collect_image_warnings(names, film.sharpnesses[chosen].tolist(), film.levels[chosen].tolist(), blurs_px)
    moving = int((film.changes > STILL_CHANGE).sum())
    if moving < MOVING_FRAMES * count:
        warnings.append(f"the camera moved too fast: only {moving} frames show its way; take twice the time for it")
    elif np.median(film.sharpnesses[chosen]) < BLURRED_SHARE * np.quantile(film.sharpnesses, 0.95):
        warnings.append("the camera moved too fast: most frames are blurred, some are not; take twice the time for the same way")
    if len(first) < count:
        warnings.append(f"only {len(first)} of {count} frames differ enough: film a longer way around the object")
    with atomic_directory(out) as folder:
        for name, image in zip(names, scaled, strict=True):
            write_image(folder / "images" / f"{name}.png", image)
        write_image(folder / "contact_sheet.png", draw_contact_sheet(scaled, names))
        facts = {
            "video": video.name,
            "video_frames": len(film.changes),
            "source_frames": [int(number) for number in chosen],
            "added_frames": len(chosen) - len(first),
            # Places of the frames before which the film was cut.
            "cuts": sorted({int(np.searchsorted(chosen, number)) for number in film.cuts if number <= chosen[-1]}),
            "warnings": warnings,
            "seconds": round(time.monotonic() - start_s, 2),
        }
        height_px, width_px = scaled[0].shape[:2]
        sharpnesses, levels = film.sharpnesses[chosen].tolist(), film.levels[chosen].tolist()
        write_capture_record(folder, [(width_px, height_px)] * len(chosen), sharpnesses, levels, blurs_px, facts)
    for warning in warnings:
        warn(warning)


def scan_video(video: Path) -> VideoScan:
    """Measure every frame. Raises StepError where the file cannot be read to its end, or holds one picture only."""
    film = measure_frames(read_frames(video))
    count = len(film.changes)
    if not count:
        raise StepError(f"{video} holds no frames that can be read; export it again as mp4 (H.264)")
    if count == 1:
        raise StepError(f"{video} holds a single frame; film the object from all around")
    promised = _count_promised_frames(video)
    spare = max(SPARE_FRAMES, SPARE_SHARE * promised)
    readable = _measure_readable_share(video) if count < promised - spare else 1.0
    if readable < READABLE_SHARE:
        raise StepError(f"{video} is cut off or damaged: {count} of its {promised} frames can be read; copy it from the camera again")
    if readable < 1.0:
        warn(f"{video}: {count} of its {promised} frames can be read; its end is damaged, the rest is taken")
    return film


def measure_frames(frames: Iterable[np.ndarray]) -> VideoScan:
    """The measures of (H, W, 3) uint8 RGB frames in their order."""
    sharpnesses, levels, changes, thumbnails = [], [], [], []
    before = None
    for frame in frames:
        # Without noise, before frames are compared.
        small = cv2.GaussianBlur(shrink_to_grey(frame), (0, 0), 1.5)
        sharpnesses.append(measure_sharpness(frame))
        levels.append(measure_level(small))
        # A change of exposure is no motion of the camera.
        even = small - small.mean()
        changes.append(0.0 if before is None else float(np.abs(even - before).mean() / (even.std() + 1.0)))
        thumbnails.append(make_thumbnail(frame))
        before = even
    return VideoScan(*(np.array(values) for values in (sharpnesses, levels, changes, thumbnails)))


def read_frames(video: Path) -> Iterator[np.ndarray]:
    """All frames in order, (H, W, 3) uint8 RGB, upright as the file's rotation says."""
    if video.suffix.lower() == ".gif":  # FFmpeg drops pictures that are shown for no time
        with open_picture(video) as film:
            yield from (np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(film))
        return
    capture = _open(video)
    try:
        while True:
            found, frame = capture.read()
            if not found:
                return
            yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
    finally:
        capture.release()


def read_numbers(video: Path, numbers: Iterable[int]) -> Iterator[tuple[int, np.ndarray]]:
    """Some frames and their numbers, in the order of the film."""
    wanted = set(numbers)
    if wanted:
        yield from ((number, frame) for number, frame in enumerate(read_frames(video)) if number in wanted)


def choose_frames(film: VideoScan, count: int) -> list[int]:
    """Numbers of up to `count` frames: the first, and the sharpest around the middle of each equal stretch of change."""
    way = film.way
    if way[-1] <= 0:
        return [0]
    step = way[-1] / max(count - 1, 1)
    chosen = [0]
    for index in range(1, count):
        # The last stretch ends with the film.
        middle = min(index * step, way[-1] - WINDOW_SHARE * step / 2)
        near = np.flatnonzero(np.abs(way - middle) <= WINDOW_SHARE * step)
        near = near[near > chosen[-1]]
        if not len(near):
            near = np.array([int(np.abs(way - middle).argmin())])
        best = int(near[film.sharpnesses[near].argmax()])
        if best not in chosen and not any(look_alike(film.thumbnails[best], film.thumbnails[other]) for other in chosen):
            chosen.append(best)
    return sorted(chosen)


def _open(video: Path) -> cv2.VideoCapture:
    video = Path(video)
    if video.is_dir():
        raise StepError(f"video {video} is a folder; name the film in it")
    if not video.is_file():
        raise StepError(f"video {video} does not exist; check the path")
    if video.suffix.lower() not in VIDEO_SUFFIXES:
        raise StepError(
            f"{video} is no video that can be read; expected {', '.join(VIDEO_SUFFIXES)}: name it so, or export it as mp4 (H.264)"
        )
    check_kind(video, "film")
    capture = cv2.VideoCapture(str(video))
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
    if not capture.isOpened():
        raise StepError(
            f"{video} cannot be read as a video: it is damaged, cut off or of an unknown format; export it again as mp4 (H.264)"
        )
    return capture


def _count_promised_frames(video: Path) -> int:
    capture = _open(video)
    try:
        return max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
    finally:
        capture.release()


def _measure_readable_share(video: Path) -> float:
    """How much of the film's duration its frames cover, 0 to 1.

    Matroska has no number of frames. OpenCV guesses it from the duration, too high where the frame rate varies.
    """
    capture = _open(video)
    try:
        times_ms = []
        while capture.grab():
            times_ms.append(capture.get(cv2.CAP_PROP_POS_MSEC))
        duration_ms = 1000.0 * capture.get(cv2.CAP_PROP_FRAME_COUNT) / max(capture.get(cv2.CAP_PROP_FPS), 1e-3)
    finally:
        capture.release()
    # How long the last frame is shown is not known.
    end_ms = times_ms[-1] + np.diff(times_ms).max()
    return float(min(end_ms / duration_ms, 1.0))


def _shrink(image: np.ndarray, max_side_px: int) -> np.ndarray:
    scale = max_side_px / max(image.shape[:2])
    if scale >= 1:
        return image
    return cv2.resize(image, (round(image.shape[1] * scale), round(image.shape[0] * scale)), interpolation=cv2.INTER_AREA)
