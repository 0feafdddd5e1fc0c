"""The truth of a rendered film, under the names of the frames that were taken from it."""

from dataclasses import replace
from pathlib import Path

from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json


def read_source_frames(capture: Path) -> list[int]:
    """The numbers of the film's frames that the capture has, in the order of its images.

    Raises:
        StepError: the capture was not made from a film.
    """
    frames = read_json(capture / "capture.json").get("source_frames")
    if frames is None:
        raise StepError(
            f"{capture / 'capture.json'} names no source_frames; only captures of a video can be compared with the truth of a film"
        )
    return [int(number) for number in frames]


def read_true_cameras(capture: Path, film_truth: Path) -> tuple[Camera, ...]:
    """The true cameras of a capture's images, in the frame of the true model, in mm, as of the middle of each exposure."""
    true = {Path(camera.name).stem: camera for camera in read_sparse_model(film_truth / "cameras").cameras}
    return tuple(replace(true[f"{number:06d}"], name=f"{index:06d}.png") for index, number in enumerate(read_source_frames(capture)))
