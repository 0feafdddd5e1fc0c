"""Make a capture that is registered by the object alone: images with masks, before registration.

It is needed where the object was turned while the ground stayed, and for the thesis's variant without a surface. The masks beside
the images are used, given by the user or found in a registered scene; if there are none, a segmentation that needs no cameras
finds them.
"""

import argparse
import importlib
import time
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from zeroshop_steps.capture.cameras_json import FILE, GivenCameras, Lens, read_given_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import SEGMENTATION, read_mask_record
from zeroshop_steps.geometry.imaging.images import list_images, read_image, read_mask, write_image, write_mask
from zeroshop_steps.methods import SEGMENTATIONS
from zeroshop_steps.runtime.files import atomic_directory, link_or_copy, read_json, write_json
from zeroshop_steps.segment.record import (
    add_rejected_argument,
    draw_mask_sheet,
    show_rejected_masks,
    warn_of_dropped,
)

SCENE = "video_segmented"
FINDERS = {name: method for name, method in SEGMENTATIONS.items() if not method.in_scene}
"""The segmentations that find masks in photos whose cameras are not known yet."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--pictures", type=Path, required=True, help="folder with images/ and, where they are known, masks/")
    parser.add_argument("--capture", type=Path, required=True, help="the capture that the pictures come from, for its capture.json")
    add_rejected_argument(parser)
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")
    finder = next(iter(FINDERS))
    parser.add_argument(
        "--segmentation", choices=list(FINDERS), default=finder, help="finds masks that are not there (default: %(default)s)"
    )
    parser.add_argument("--options", nargs=argparse.REMAINDER, default=[], help="options of this segmentation; they come last")


def run(args: argparse.Namespace) -> None:
    """Write the capture."""
    start_s = time.monotonic()
    paths = list_images(args.pictures / "images")
    sizes_px = [(image.shape[1], image.shape[0]) for image in map(read_image, paths)]
    if (args.pictures / "masks").is_dir():
        masks = [read_mask(args.pictures / "masks" / f"{path.stem}.png", size) for path, size in zip(paths, sizes_px, strict=True)]
        record = read_mask_record(args.pictures) | {"dropped": {}, "cut_off": []}
    else:
        with show_rejected_masks(paths, args.rejected):
            finder = load_finder(args.segmentation)
            masks, record = finder.mask_photos(paths, sizes_px, parse_options(finder, args.options))
    record["seconds"] = round(time.monotonic() - start_s, 2)
    facts, cameras = read_json(args.capture / "capture.json"), _read_cameras(args.capture / FILE, args.pictures, paths)
    write_capture(args.out, paths, masks, record, facts, cameras)


def _read_cameras(path: Path, pictures: Path, paths: list[Path]) -> GivenCameras | None:
    """The cameras that came with a capture, for the pictures of its photos; those of a registered scene are undistorted, by its lenses."""
    if not path.is_file():
        return None
    given = read_given_cameras(path)
    lenses: dict[str, Lens] = {}
    if (pictures / "sparse").is_dir():
        cameras = read_sparse_model(pictures / "sparse").cameras
        lenses = {Path(one.name).stem: Lens.pinhole(one.intrinsics, (one.width_px, one.height_px)) for one in cameras}
    by_stem = {Path(name).stem: one for name, one in given.images.items()}
    known = [picture for picture in paths if picture.stem in by_stem]
    cameras_of = {
        picture.name: replace(by_stem[picture.stem], lens=lenses.get(picture.stem, by_stem[picture.stem].lens)) for picture in known
    }
    return replace(given, images=cameras_of)


def load_finder(name: str) -> ModuleType:
    """The module of a segmentation of FINDERS, which has `add_mask_arguments(parser)` and `mask_photos(paths, sizes_px, args)`."""
    return importlib.import_module(f"zeroshop_steps.{FINDERS[name].step}")


def parse_options(finder: ModuleType, options: list[str]) -> argparse.Namespace:
    """The options of a segmentation as its `mask_photos` takes them."""
    parser = argparse.ArgumentParser(prog=finder.__name__, add_help=False)
    parser.add_argument("--seed", type=int, default=0)
    finder.add_mask_arguments(parser)
    return parser.parse_args(options)


def write_capture(
    out: Path,
    paths: list[Path],
    masks: list[np.ndarray],
    record: dict[str, Any],
    facts: dict[str, Any],
    cameras: GivenCameras | None = None,
) -> None:
    """Write images/, masks/, capture.json, segmentation.json and contact_sheet.png, without the pictures whose mask was dropped.

    Cameras of the pictures, where they came with these, are written to cameras.json.

    Args:
        out: folder to write.
        paths: the pictures.
        masks: (H, W) bool of each.
        record: for segmentation.json.
        facts: capture.json of the capture that they come from; its entries for single images count the images before any was left out.
    """
    dropped = set(record["dropped"])
    with atomic_directory(out) as folder:
        (folder / "images").mkdir()
        for path, mask in zip(paths, masks, strict=True):
            if path.name not in dropped:
                link_or_copy(path, folder / "images" / path.name)
                write_mask(folder / "masks" / f"{path.stem}.png", mask)
        write_json(folder / "capture.json", {**facts, "scene": SCENE, "images": len(paths) - len(dropped), "seconds": record["seconds"]})
        write_json(folder / SEGMENTATION, record)
        write_image(folder / "contact_sheet.png", draw_mask_sheet(paths, masks, dropped))
        if cameras is not None:
            cameras.write(folder / FILE)
    warn_of_dropped(record)
