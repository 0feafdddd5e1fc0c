"""Make a capture that is registered by the object alone: images with masks, before registration.

It is needed where the object was turned while the ground stayed, and for the thesis's variant without a surface. The masks beside
the images are used, given by the user or found in a registered scene; if there are none, grounded_sam finds them.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.images import list_images, read_image, read_mask, write_image, write_mask
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json
from zeroshop_steps.segment.grounded_sam import ImageSequence, add_network_arguments, run_networks
from zeroshop_steps.segment.record import (
    RECORD,
    add_rejected_argument,
    draw_mask_sheet,
    link_or_copy,
    read_mask_record,
    show_rejected_masks,
    warn_of_dropped,
)

SCENE = "video_segmented"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--pictures", type=Path, required=True, help="folder with images/ and, where they are known, masks/")
    parser.add_argument("--capture", type=Path, required=True, help="the capture that the pictures come from, for its capture.json")
    add_network_arguments(parser)
    add_rejected_argument(parser)
    parser.add_argument("--seed", type=int, default=0, help="changes nothing; every segmentation takes it (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")


def run(args: argparse.Namespace) -> None:
    """Write the capture."""
    start_s = time.monotonic()
    paths = list_images(args.pictures / "images")
    height_px, width_px = read_image(paths[0]).shape[:2]
    if (args.pictures / "masks").is_dir():
        masks = [read_mask(args.pictures / "masks" / f"{path.stem}.png", (width_px, height_px)) for path in paths]
        record = read_mask_record(args.pictures) | {"dropped": {}, "cut_off": []}
    else:
        with show_rejected_masks(paths, args.rejected):
            masks, record = run_networks(ImageSequence(paths, (width_px, height_px)), args)
    record["seconds"] = round(time.monotonic() - start_s, 2)
    write_capture(args.out, paths, masks, record, read_json(args.capture / "capture.json"))


def write_capture(out: Path, paths: list[Path], masks: list[np.ndarray], record: dict[str, Any], facts: dict[str, Any]) -> None:
    """Write images/, masks/, capture.json, segmentation.json and contact_sheet.png, without the pictures whose mask was dropped.

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
        write_json(folder / RECORD, record)
        write_image(folder / "contact_sheet.png", draw_mask_sheet(paths, masks, dropped))
    warn_of_dropped(record)
