"""Film a model as a phone would: a video of it on a cluttered table, photos of the empty table with a printed board, and the truth.

The camera goes around twice by hand (handheld_camera.py). Each frame is the mean, in linear light, of what it sees while the shutter is
open; exposure and white balance drift, the sensor adds noise, the video is compressed. `truth/` is for judging only: masks and
cameras of all frames, numbered as in the video, and the object's height.
"""

import argparse
import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, write_cameras
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, write_json
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.synthetic import virtual_capture
from zeroshop_steps.synthetic.board_scene import place_empty_cameras
from zeroshop_steps.synthetic.rendering.renderer import expose
from zeroshop_steps.synthetic.rendering.shading import use_threads
from zeroshop_steps.synthetic.scenes.camera_rings import SENSOR_WIDTH_MM
from zeroshop_steps.synthetic.scenes.film_scene import BOARD_GAP_MM, FilmRenderer, FilmTable, lay_table
from zeroshop_steps.synthetic.scenes.handheld_camera import DURATION_S, FOCAL_IN_WIDTHS, FilmLens, HandheldCamera, SmoothNoise
from zeroshop_steps.synthetic.scenes.table_tops import TABLE_TOPS

CACHED = Cached(inputs=("model",), ignored=("threads",))
BOARDS = ("beside", "empty_scene")
SIZE_PX = (960, 540)
FRAMES = 64
SHUTTER_S = 1 / 50  # open for each frame
STEP_PX, MOST_STEPS = 2.0, 4  # the shutter's time is cut into pictures this far apart
EXPOSURE_DRIFT, TINT_DRIFT = 0.13, 0.02  # standard deviations of the logarithm
CODEC = "mp4v"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--model", type=Path, required=True, help="textured PLY in mm, upright, z up")
    parser.add_argument(
        "--board", choices=BOARDS, required=True, help="beside the object in the film, or only in photos of the empty scene"
    )
    parser.add_argument(
        "--table", choices=tuple(TABLE_TOPS), default="print", help="what the table's top looks like (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the table, the hand, the light and the noise (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default: all)")
    parser.add_argument("--out", type=Path, required=True, help="folder to write: film.mp4, empty_scene/ and truth/")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    use_threads(args.threads)
    render_film(args.model, args.board == "beside", args.seed, args.out, top=args.table)


def render_film(
    model: Path, board_beside: bool, seed: int, out: Path, size_px: tuple[int, int] = SIZE_PX, frames: int = FRAMES, top: str = "print"
) -> None:
    """Write the film, the photos of the empty scene and the truth into the folder `out`.

    Raises:
        StepError: as `virtual_capture.render_capture` does.
    """
    mesh, bounds, info = virtual_capture.read_object(model, *size_px, seed)
    rng = np.random.default_rng([seed, *np.frombuffer(str(info.get("name", "")).encode(), np.uint8)])
    table = lay_table(mesh, bounds, seed, rng, top)
    lens = FilmLens(*size_px)
    hand = HandheldCamera(bounds, float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))), lens, rng)
    # As fast as automatic exposure and white balance change.
    drift = SmoothNoise(rng, (0.02, 0.12), 4)
    with atomic_directory(out) as folder:
        view = FilmRenderer(table, with_object=True, with_board=board_beside)
        cameras = _record(view, hand, drift, rng, folder, frames)
        write_cameras(folder / "truth" / "cameras", cameras)
        height_mm = float(np.ptp(mesh.vertices[:, 2]))
        write_json(folder / "truth" / "truth.json", {"height_m": round(height_mm / 1000, 6), "frames": frames, "duration_s": DURATION_S})
        for name, image in _photograph_empty_scene(table, mesh, size_px, rng):
            write_image(folder / "empty_scene" / name, image)


def _record(
    view: FilmRenderer, hand: HandheldCamera, drift: SmoothNoise, rng: np.random.Generator, folder: Path, frames: int
) -> list[Camera]:
    """Write the video and the true masks; the cameras at the middle of each exposure come back."""
    cameras = []
    with _open_video(folder / "film.mp4", hand.lens, frames / DURATION_S) as video:
        for number in track(range(frames), "film", frames):
            time_s = number / frames * DURATION_S
            camera = hand.camera_at(time_s + SHUTTER_S / 2, f"{number:06d}.png")
            steps = _count_steps(hand, time_s, view.landmarks_mm)
            linear = (
                sum(view.render(hand.camera_at(time_s + SHUTTER_S * (step + 0.5) / steps, camera.name)) for step in range(steps)) / steps
            )
            brightness, *tint = drift.sample_at(time_s)
            gains = np.exp(EXPOSURE_DRIFT * brightness + TINT_DRIFT * np.array(tint)).astype(np.float32)
            video.write(cv2.cvtColor(expose(linear * gains, rng), cv2.COLOR_RGB2BGR))
            write_mask(folder / "truth" / "masks" / camera.name, view.render_mask(camera))
            cameras.append(camera)
    return cameras


def _count_steps(hand: HandheldCamera, time_s: float, points_mm: np.ndarray) -> int:
    """How many pictures make up one exposure: none is farther than `STEP_PX` from the next."""
    opened, closed = (hand.camera_at(moment, "").project(points_mm)[0] for moment in (time_s, time_s + SHUTTER_S))
    return int(np.clip(np.ceil(np.linalg.norm(closed - opened, axis=1).max() / STEP_PX), 1, MOST_STEPS))


@contextlib.contextmanager
def _open_video(path: Path, lens: FilmLens, frames_a_second: float) -> Iterator[cv2.VideoWriter]:
    # One thread: how a frame is cut into slices would depend on their number.
    os.environ.setdefault("OPENCV_FFMPEG_WRITER_OPTIONS", "threads;1")
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*CODEC), frames_a_second, (lens.width_px, lens.height_px))
    if not writer.isOpened():
        raise StepError(f"{path} cannot be written: this OpenCV has no {CODEC} encoder; install opencv-python-headless")
    try:
        yield writer
    finally:
        writer.release()
    # The encoder does not say that the disk is full; a film without its end has no index, either, and cannot be opened.
    if not cv2.VideoCapture(str(path)).isOpened():
        raise OSError(errno.ENOSPC, "the film could not be written whole", str(path))


def _photograph_empty_scene(
    table: FilmTable, mesh: Mesh, size_px: tuple[int, int], rng: np.random.Generator
) -> Iterator[tuple[str, np.ndarray]]:
    """Name and (height, width, 3) uint8 of each photo of the table with the board and without the object."""
    view = FilmRenderer(table, with_object=False, with_board=True)
    for camera in place_empty_cameras(mesh, table.bounds, *size_px, FOCAL_IN_WIDTHS * SENSOR_WIDTH_MM, BOARD_GAP_MM):
        yield camera.name, expose(view.render(camera), rng)
