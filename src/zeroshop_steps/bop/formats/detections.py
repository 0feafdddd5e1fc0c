"""Detections in BOP's COCO JSON (since the challenge of 2022): boxes and masks of objects in images."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pycocotools import mask as coco_masks

from zeroshop_steps.bop.formats.estimates import SAME_TIME_S
from zeroshop_steps.bop.formats.schema import check_content, read_content
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_write

SizeOf = Callable[[int, int], tuple[int, int] | None]

LARGEST_SIDE_PX, LARGEST_IMAGE_PX = 65_536, 250_000_000
"""Of an image whose masks are read: COCO's code counts pixels in 32 bits, and a mask takes as many bytes."""


@dataclass(frozen=True)
class Detection:
    """One detected object.

    Attributes:
        scene_id, image_id, object_id: BOP's numbers.
        score: confidence; higher is more confident.
        box_px: (x, y, width, height), or None.
        mask: COCO's compressed run lengths {"size": [height, width], "counts": bytes}, or None.
        seconds: time spent on the image, the same for all of its detections; -1 if unknown.
    """

    scene_id: int
    image_id: int
    object_id: int
    score: float
    box_px: tuple[float, float, float, float] | None
    mask: dict | None
    seconds: float = -1.0

    def require_mask(self) -> dict:
        """Its mask. Raises StepError where it has none."""
        if self.mask is None:
            where = f"object {self.object_id} in scene {self.scene_id}, image {self.image_id}"
            raise StepError(f"a detection of {where} has no segmentation; give run lengths or polygons")
        return self.mask


def encode_mask(mask: np.ndarray) -> dict:
    """COCO's compressed run lengths of a (height, width) bool mask."""
    return coco_masks.encode(np.asfortranarray(mask.astype(np.uint8)))


def decode_mask(encoded: dict) -> np.ndarray:
    """The (height, width) bool mask of compressed run lengths."""
    return np.ascontiguousarray(coco_masks.decode(encoded).astype(bool))


def mask_to_box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """(x, y, width, height) in px around a bool mask that is not empty; as in COCO, one pixel has width 1."""
    columns, rows = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
    return int(columns[0]), int(rows[0]), int(columns[-1] - columns[0] + 1), int(rows[-1] - rows[0] + 1)


def read_detections(path: Path, find_size: SizeOf = lambda scene_id, image_id: None) -> list[Detection]:
    """Read a COCO result file, plain or gzipped, or the annotations of a whole COCO dataset. An empty list has no detections.

    Args:
        path: of the file.
        find_size: gives the (width, height) of an image by its scene and number, for polygons; None where it is unknown.

    Raises:
        StepError: an entry has the wrong form, the run lengths of a mask do not fit its size, or times differ within an image.
    """
    entries, sizes = _read_entries(path)
    found: list[Detection] = []
    seconds: dict[tuple[int, int], float] = {}
    for index, entry in enumerate(entries):
        box, mask = entry.get("bbox") or None, entry.get("segmentation") or None
        if box is not None and (len(box) != 4 or box[2] < 0 or box[3] < 0):
            raise StepError(f"{path}: entry {index}: bbox is {box}; expected [x, y, width, height] in pixels")
        if box is None and mask is None:
            raise StepError(f"{path}: entry {index} has neither bbox nor segmentation; expected one of them")
        time_s = float(entry.get("time", -1.0))
        image = entry["scene_id"], entry["image_id"]
        if isinstance(mask, list):
            mask = _fill_polygons(f"{path}: entry {index}", mask, sizes.get(image) or find_size(*image))
        if time_s >= 0 and abs(seconds.setdefault(image, time_s) - time_s) > SAME_TIME_S:
            raise StepError(
                f"{path}: entry {index}: the time differs from that of other detections in scene {image[0]}, image {image[1]};"
                " give the seconds spent on the whole image in each entry"
            )
        found.append(
            Detection(
                *image, entry["category_id"], float(entry["score"]), box and tuple(box), mask and _compress(path, index, mask), time_s
            )
        )
    return found


def _read_entries(path: Path) -> tuple[list[dict], dict[tuple[int, int], tuple[int, int]]]:
    """The entries of a result file, or the annotations of a COCO dataset as such entries; and the sizes that it lists by image."""
    content = read_content(path)
    sizes = {}
    if isinstance(content, dict):
        check_content(path, content, "coco")
        folder = Path(path).resolve().parent.name
        # BOP's scene_gt_coco.json lies in the folder of its scene.
        scenes = {one["id"]: one.get("scene_id", int(folder) if folder.isdigit() else None) for one in content["images"]}
        sizes = {
            (scenes[one["id"]], one["id"]): (one["width"], one["height"]) for one in content["images"] if {"width", "height"} <= set(one)
        }
        content = [{"scene_id": scenes.get(one["image_id"]), "score": 1.0} | one for one in content["annotations"]]
        if any(one["scene_id"] is None for one in content):
            raise StepError(
                f"{path} is a COCO dataset whose images have no scene_id; add it to each image, or put the file into the scene's folder,"
                " such as 000001"
            )
        if content:
            warn(f"{path} is a whole COCO dataset; its {len(content)} annotations are taken for detections")
    check_content(path, content, "detections")
    return content, sizes


def _fill_polygons(where: str, polygons: list[list[float]], size_px: tuple[int, int] | None) -> dict:
    """COCO's compressed run lengths of polygons, each x, y, x, y ..., in an image of (width, height)."""
    if size_px is None:
        raise StepError(
            f"{where}: its segmentation is a polygon, and the size of its image is unknown; give the whole COCO dataset, whose images have"
            " width and height, or run lengths"
        )
    if any(len(polygon) % 2 for polygon in polygons):
        raise StepError(f"{where}: a polygon of its segmentation has an odd number of coordinates; expected x, y, x, y ...")
    width, height = size_px
    if max(width, height) > LARGEST_SIDE_PX or height * width > LARGEST_IMAGE_PX:
        raise StepError(f"{where}: its image has the size {width} x {height} px, larger than any image; is the file whole?")
    merged = coco_masks.merge(coco_masks.frPyObjects(polygons, height, width))
    return {"size": [height, width], "counts": merged["counts"].decode()}


def write_detections(path: Path, detections: list[Detection]) -> None:
    """Write detections as COCO JSON with uncompressed run lengths, which BOP's tools expect."""
    entries = []
    for detection in detections:
        entry = {
            "scene_id": detection.scene_id,
            "image_id": detection.image_id,
            "category_id": detection.object_id,
            "score": float(detection.score),
            "bbox": [float(value) for value in detection.box_px] if detection.box_px else [],
            "segmentation": _to_run_lengths(detection.mask) if detection.mask else {},
            "time": float(detection.seconds),
        }
        entries.append(entry)
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(entries, allow_nan=False) + "\n")


def _to_run_lengths(mask: dict) -> dict:
    """Uncompressed run lengths, column by column; the first one is of the background."""
    pixels = decode_mask(mask).ravel(order="F")
    ends = np.flatnonzero(np.diff(pixels)) + 1
    counts = np.diff(np.concatenate([[0], ends, [len(pixels)]])).tolist()
    return {"size": [int(side) for side in mask["size"]], "counts": [0, *counts] if len(pixels) and pixels[0] else counts}


def _compress(path: Path, index: int, mask: dict) -> dict:
    """Compressed run lengths of a mask in entry `index` of the file. Raises StepError if they do not fit its size."""
    if "size" not in mask or "counts" not in mask:
        raise StepError(f"{path}: entry {index}: segmentation lacks size or counts; expected run lengths, or polygons")
    height, width = mask["size"]
    if max(height, width) > LARGEST_SIDE_PX or height * width > LARGEST_IMAGE_PX:
        size = f"{height} x {width} px"
        raise StepError(f"{path}: entry {index}: its segmentation has the size {size}, larger than any image; is the file whole?")
    counts = mask["counts"]
    if isinstance(counts, str):
        try:
            counts = _decode_counts(counts)
        except IndexError:
            raise StepError(f"{path}: entry {index}: the run lengths of its segmentation end within a number; is the file whole?") from None
    if any(not isinstance(count, int | float) or count < 0 or count % 1 for count in counts) or sum(counts) != height * width:
        raise StepError(
            f"{path}: entry {index}: the run lengths of its segmentation add up to {sum(counts)}, its size is {height} x {width}"
        )
    return coco_masks.frPyObjects({"size": [height, width], "counts": list(map(int, counts))}, height, width)


def _decode_counts(text: str) -> list[int]:
    """Decode COCO's text of run lengths: five bits per character; from the third on, differences to the last but one.

    Raises:
        IndexError: the text ends within a number.
    """
    counts: list[int] = []
    place = 0
    while place < len(text):
        value, bits, more = 0, 0, True
        while more:
            code = ord(text[place]) - 48
            value |= (code & 31) << bits
            place, bits, more = place + 1, bits + 5, bool(code & 32)
        if code & 16:
            value -= 1 << bits
        counts.append(value + (counts[-2] if len(counts) > 2 else 0))
    return counts
