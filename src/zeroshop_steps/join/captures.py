"""Put the captures of several passes side by side, as the capture of the joined cameras: pictures, and the truth where it is known.

True cameras are moved into the frame of the model as it stood in the first pass.
"""

import argparse
import itertools
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.capture.cameras_json import FILE, read_given_cameras
from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model, write_cameras
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.geometry.imaging.images import list_images
from zeroshop_steps.join.pass_images import make_joint_name
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json
from zeroshop_steps.synthetic.film_truth import read_true_cameras as film_cameras

CACHED = Cached(inputs=("captures", "turned", "film_truths"))
PICTURES = ("images", "masks")
SOURCES = ("source_names", "source_frames")
"""Entries of capture.json that say what the pictures of a pass were: names of photos, or frames of a film."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--captures", type=Path, nargs="+", required=True, help="captures of the passes, the first first")
    parser.add_argument(
        "--turned", type=Path, nargs="*", default=[], help="models as they were turned for the later passes, if they are known"
    )
    parser.add_argument("--film-truths", type=Path, nargs="*", default=[], help="truths of the films that the captures are of, if rendered")
    parser.add_argument("--scene", required=True, help="name of the joined scene")
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")


def run(args: argparse.Namespace) -> None:
    """Write the capture."""
    turned = [np.eye(4), *(np.array(read_json(folder / "turned.json")["turned_from_model"]) for folder in args.turned)]
    films = args.film_truths or [None] * len(args.captures)
    records = [read_json(folder / "capture.json") for folder in args.captures]
    with atomic_directory(args.out) as folder:
        for part in ("", "held_out"):
            copy_pictures([capture / part for capture in args.captures], folder / part)
            true = (
                [read_true_cameras(capture / part, film) for capture, film in zip(args.captures, films, strict=True)] if args.turned else []
            )
            if any(true):
                moved = [put_into_first_pass(*one, number) for number, one in enumerate(zip(true, turned, strict=True), start=1)]
                write_cameras(folder / part / "truth", sorted(itertools.chain(*moved), key=lambda camera: camera.name))
        copy_given_cameras(args.captures[0], folder)
        images = [
            record.get("images", len(list_images(capture / "images"))) for record, capture in zip(records, args.captures, strict=True)
        ]
        sources = [{name: record.pop(name) for name in SOURCES if name in record} for record in records]
        joined = {"scene": args.scene, "images": sum(images), "images_of_passes": images, "sources_of_passes": sources}
        write_json(folder / "capture.json", records[0] | joined)


def copy_pictures(captures: list[Path], out: Path) -> None:
    """Copy images, and masks where all captures have them, under their joint names."""
    for kind in PICTURES:
        if all((capture / kind).is_dir() for capture in captures):
            (out / kind).mkdir(parents=True, exist_ok=True)
            for number, capture in enumerate(captures, start=1):
                for path in list_images(capture / kind):
                    shutil.copyfile(path, out / kind / make_joint_name(number, path.name))


def copy_given_cameras(first: Path, out: Path) -> None:
    """The cameras that came with the first pass, under their joint names: they tell the unit of all, whose frame is its own."""
    if (first / FILE).is_file():
        given = read_given_cameras(first / FILE)
        replace(given, images={make_joint_name(1, name): camera for name, camera in given.images.items()}).write(out / FILE)


def read_true_cameras(capture: Path, film_truth: Path | None) -> Sequence[Camera]:
    """The true cameras of a rendered capture or film, in the frame of the model as it lay; none for what a film lacks."""
    if film_truth is None:
        return read_sparse_model(capture / "truth").cameras
    return film_cameras(capture, film_truth) if (capture / "images").is_dir() else ()


def put_into_first_pass(cameras: Sequence[Camera], turned_from_model: np.ndarray, number: int) -> list[Camera]:
    """The cameras of a pass under their joint names, in the frame of the model as it stood in the first pass."""
    model_from_turned = np.linalg.inv(turned_from_model)
    return [replace(transform_camera(one, model_from_turned), name=make_joint_name(number, one.name)) for one in cameras]
