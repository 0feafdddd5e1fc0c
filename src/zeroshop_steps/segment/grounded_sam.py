"""Mask the object that a few words describe: Grounding DINO finds a box, SAM 2 follows it through all images.

Photos differ more than the frames of a video. Where SAM 2 loses the object, or its mask contradicts those of the other views,
Grounding DINO searches that image again, and SAM 2 starts once more from all boxes. Both networks are read from files; nothing is
downloaded.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import read_views, space_evenly
from zeroshop_steps.geometry.imaging.images import compute_overlap, read_image, require_one_size
from zeroshop_steps.networks.devices import DEVICES, choose_device, measure_free_bytes
from zeroshop_steps.networks.grounding_dino import Box, Detector, choose_box, describe_nothing_found
from zeroshop_steps.networks.pretrained import require_model
from zeroshop_steps.networks.sam2 import ObjectTracker, TrackedMask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.quality.mask_agreement import assess_masks, find_corners
from zeroshop_steps.segment.quality.mask_quality import check_enough_good, describe_quality
from zeroshop_steps.segment.quality.tidy_mask import tidy_mask
from zeroshop_steps.segment.record import add_common_arguments, show_rejected_masks, write_segmented

PROMPT = "object in the middle."
MIN_SCORE = 0.25
FIRST_PICTURES = 8
"""Number of images, evenly spread from the first one on, that are searched for the object before giving up."""
THREADS = 2
"""Always the same number, because sums in another order change single pixels of the masks."""
MEMORY_MB, MEMORY_PICTURE_MB = 3000, 4
"""Beside the networks' weights: what a pass takes at its peak, and what is kept of each image."""

Detect = Callable[[np.ndarray], list[Box]]
Follow = Callable[[dict[int, Box]], list[TrackedMask]]


@dataclass(frozen=True)
class ImageSequence:
    """The images to be masked.

    Attributes:
        paths: image files in the order in which they were taken.
        size_px: (width, height) of all.
        cameras: of all, where they are known.
    """

    paths: list[Path]
    size_px: tuple[int, int]
    cameras: list[Camera] | None = None

    @property
    def names(self) -> list[str]:
        """File names."""
        return [path.name for path in self.paths]

    def image(self, index: int) -> np.ndarray:
        """(H, W, 3) uint8 RGB."""
        return read_image(self.paths[index])


METHOD: dict[str, Any] = {
    "rank": 0,
    "models": {
        "detector": (
            "grounding-dino-base",
            ("model.safetensors", "config.json", "preprocessor_config.json", "tokenizer.json", "tokenizer_config.json"),
        ),
        "tracker": ("sam2.1-hiera-large", ("model.safetensors", "config.json")),
    },
    "prompt": True,
    "mem_mb": 8000,
    "runtime_min": 60,
}
MODELS = METHOD["models"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    add_mask_arguments(parser)


def add_mask_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the prompt and of the networks, whether or not the cameras are known."""
    parser.add_argument("--prompt", default=PROMPT, help='what to look for, in English (default: "%(default)s")')
    parser.add_argument("--min-score", type=float, default=MIN_SCORE, help="least score of a box (default: %(default)s)")
    parser.add_argument(
        "--detector", default=MODELS["detector"][0], help="folder of Grounding DINO below resources/weights (default: %(default)s)"
    )
    parser.add_argument("--tracker", default=MODELS["tracker"][0], help="folder of SAM 2 below resources/weights (default: %(default)s)")
    parser.add_argument("--device", choices=DEVICES, default="auto", help="auto is cuda where there is one (default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    start_s = time.monotonic()
    views, _ = read_views(args.scene)
    cameras = [view.camera for view in views]
    size_px = _require_film([(camera.width_px, camera.height_px) for camera in cameras])
    pictures = ImageSequence([view.image_path for view in views], size_px, cameras)
    with show_rejected_masks(pictures.paths, args.rejected):
        masks, record = run_networks(pictures, args)
    record["seconds"] = round(time.monotonic() - start_s, 2)
    write_segmented(args.scene, args.out, views, masks, set(record["dropped"]), record)


def mask_photos(paths: list[Path], sizes_px: list[tuple[int, int]], args: argparse.Namespace) -> tuple[list[np.ndarray], dict[str, Any]]:
    """(H, W) bool masks of photos whose cameras are not known, and the record of their quality.

    Args:
        paths: the photos in the order in which they were taken.
        sizes_px: (width, height) of each.
        args: those of `add_mask_arguments`.

    Raises:
        StepError: as `find_masks`; or the sizes differ, a network is missing or damaged, or memory would not do.
    """
    return run_networks(ImageSequence(paths, _require_film(sizes_px)), args)


def _require_film(sizes_px: list[tuple[int, int]]) -> tuple[int, int]:
    """The (width, height) of all photos. Raises StepError where they differ: SAM 2 follows the object as through a film."""
    return require_one_size(
        sizes_px,
        "the photos have",
        "the network follows the object through pictures of one size; use segmentation: support_plane, give masks, or export all photos"
        " in one size",
    )


def run_networks(pictures: ImageSequence, args: argparse.Namespace) -> tuple[list[np.ndarray], dict[str, Any]]:
    """As `find_masks`, with the networks that the arguments of `add_mask_arguments` name."""
    folders = [require_model(args.detector, MODELS["detector"][1]), require_model(args.tracker, MODELS["tracker"][1])]
    device = torch.device(choose_device(args.device))
    torch.set_num_threads(THREADS)
    _check_memory(folders, len(pictures.paths), device.type)
    detector, tracker = Detector(folders[0], device), ObjectTracker(folders[1], device)

    def follow(boxes: dict[int, Box]) -> list[TrackedMask]:
        corners = {index: box.corners_px for index, box in boxes.items()}
        return tracker.follow(pictures.image, len(pictures.paths), pictures.size_px, corners)

    masks, record = find_masks(pictures, lambda image: detector.detect(image, args.prompt), follow, args.prompt, args.min_score)
    return masks, record | {"detector": args.detector, "tracker": args.tracker, "device": device.type}


def _check_memory(folders: list[Path], pictures: int, device: str) -> None:
    """Print how much memory is needed and how much is free; raise StepError where that is too little."""
    needed_mb = sum((folder / "model.safetensors").stat().st_size for folder in folders) / 2**20 + MEMORY_MB + MEMORY_PICTURE_MB * pictures
    free_mb = measure_free_bytes(device) / 2**20
    print(f"needs about {needed_mb:.0f} MB of memory on {device}, {free_mb:.0f} MB are free")
    if needed_mb > free_mb:
        raise StepError(
            f"about {needed_mb:.0f} MB of memory are needed on {device}, {free_mb:.0f} MB are free; close other programs, name smaller "
            "networks (segment.grounded_sam.detector and tracker), or take segmentation: support_plane"
        ) from MemoryError()


def find_masks(
    pictures: ImageSequence, detect: Detect, follow: Follow, prompt: str, min_score: float
) -> tuple[list[np.ndarray], dict[str, Any]]:
    """Masks of all pictures, (H, W) bool of their size, and the record of their quality.

    Args:
        pictures: what is to be masked. Where their cameras are known, masks are judged by what they have in common.
        detect: the boxes in an image, the best first.
        follow: what boxes in some of the pictures lead to in all of them.
        prompt: what is looked for, for messages.
        min_score: of a box.

    Raises:
        StepError: no such object is found, or too few masks are good.
    """
    names = pictures.names
    boxes = dict([_find_first_box(pictures, detect, prompt, min_score)])
    masks = [tracked.mask for tracked in follow(boxes)]
    hulls, qualities = assess_masks(masks, pictures.cameras)
    lost = [index for index, quality in enumerate(qualities) if quality.fault]
    again = {}
    for index in lost:
        box = choose_box(detect(pictures.image(index)), pictures.size_px, min_score, find_corners(hulls[index]))
        if box is not None and box != boxes.get(index):
            again[index] = box
    if again:
        print(f"looked for the object again in {len(again)} of {len(lost)} pictures where it was lost")
        boxes |= again
        masks = [_choose_better(old, new.mask, hull) for old, new, hull in zip(masks, follow(boxes), hulls, strict=True)]
        hulls, qualities = assess_masks(masks, pictures.cameras)
    masks = [tidy_mask(mask.astype(np.float32), hull) > 0.5 if hull.any() else mask for mask, hull in zip(masks, hulls, strict=True)]
    check_enough_good(qualities, names, masks)
    seen = {names[i]: {"corners_px": [round(x, 1) for x in box.corners_px], "score": round(box.score, 3)} for i, box in boxes.items()}
    lost_names = [names[index] for index in lost]
    return masks, {
        "method": "grounded_sam",
        "prompt": prompt,
        "boxes": seen,
        "lost_at_first": lost_names,
        **describe_quality(qualities, names),
    }


def _find_first_box(pictures: ImageSequence, detect: Detect, prompt: str, min_score: float) -> tuple[int, Box]:
    """The first picture that shows the object, usually the very first, and its box there."""
    seen = {}
    for index in space_evenly(len(pictures.paths), FIRST_PICTURES):
        boxes = detect(pictures.image(index))
        box = choose_box(boxes, pictures.size_px, min_score)
        if box is not None:
            return index, box
        seen[pictures.names[index]] = boxes
    raise describe_nothing_found(seen, prompt, min_score, pictures.size_px)


def _choose_better(old: np.ndarray, new: np.ndarray, hull: np.ndarray) -> np.ndarray:
    """Whichever of two masks agrees better with the other views; the new one where they do not tell."""
    return old if hull.any() and compute_overlap(old, hull) >= compute_overlap(new, hull) else new
