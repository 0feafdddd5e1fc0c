"""Compare the masks of a rendered film with the true ones: the intersection over union in every frame that was extracted.

No other step reads the true masks. They are undistorted by the lens that the registration found. Writes a tidy CSV with one row per
frame, without a value where the frame was left out, and rows of camera `all`; beside it a picture of the worst frames.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.bop.pictures import MASK_TINT
from zeroshop_steps.geometry.imaging.contact_sheets import COLUMNS, GREEN, RED, TILE_WIDTH_PX, arrange_in_rows, write_label
from zeroshop_steps.geometry.imaging.images import read_image, read_mask, write_image
from zeroshop_steps.register.scene.record import find_lens, read_registration
from zeroshop_steps.register.scene.undistortion import undistort_by_lens
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import write_table
from zeroshop_steps.synthetic.film_truth import read_source_frames


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--cameras", type=Path, required=True, help="folder that a segmentation wrote")
    parser.add_argument("--capture", type=Path, required=True, help="the film's capture, which names the extracted frames")
    parser.add_argument("--truth", type=Path, required=True, help="the film's truth with masks/ of all frames")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write; the picture goes beside it as .png")


@dataclass(frozen=True)
class FrameMasks:
    """The two masks of a frame that was extracted from the film.

    Attributes:
        name: stem of its files.
        true: (H, W) bool, undistorted.
        found: (H, W) bool; None if the frame was left out.
    """

    name: str
    true: np.ndarray
    found: np.ndarray | None

    @property
    def overlap(self) -> float | None:
        """Their intersection over union; None if the frame was left out."""
        return None if self.found is None else intersection_over_union(self.found, self.true)


def run(args: argparse.Namespace) -> None:
    """Write the CSV and the picture."""
    frames = read_frame_masks(args.cameras, args.capture, args.truth)
    overlaps = {frame.name: frame.overlap for frame in frames}
    found = np.array([overlap for overlap in overlaps.values() if overlap is not None])
    summary: dict[str, float] = {"masks": len(found), "left_out": len(overlaps) - len(found)}
    if len(found):
        summary |= {"iou_median": round(float(np.median(found)), 4), "iou_min": round(float(found.min()), 4)}
    rows: list[dict] = [{"camera": "all", "measure": key, "value": value} for key, value in summary.items()]
    for name, overlap in overlaps.items():
        rows.append({"camera": name, "measure": "iou", "value": None if overlap is None else round(overlap, 4)})
    write_table(args.out, rows)
    compared = [frame for frame in frames if frame.found is not None]
    worst = sorted(compared, key=lambda frame: overlaps[frame.name] or 0.0)[:COLUMNS]
    images = [read_image(args.cameras / "images" / f"{frame.name}.png") for frame in worst]
    write_image(args.out.with_suffix(".png"), draw_mask_errors(worst, images))


def read_frame_masks(cameras: Path, capture: Path, truth: Path) -> list[FrameMasks]:
    """The frames of a capture with their masks.

    Raises:
        StepError: the registration or the segmentation failed, or the capture is not from this film.
    """
    record = read_registration(cameras)
    judged = []
    for index, number in enumerate(read_source_frames(capture)):
        path = cameras / "masks" / f"{index:06d}.png"
        true = undistort_mask(read_mask(truth / "masks" / f"{number:06d}.png"), find_lens(record, path.stem))
        judged.append(FrameMasks(path.stem, true, read_mask(path) if path.is_file() else None))
    return judged


def draw_mask_errors(frames: list[FrameMasks], images: list[np.ndarray]) -> np.ndarray:
    """(H, W, 3) uint8: a tile of each frame around the object, red where the mask is too large, green where it is too small."""
    tiles = []
    for frame, image in zip(frames, images, strict=True):
        found = np.zeros_like(frame.true) if frame.found is None else frame.found
        rows, columns = np.nonzero(frame.true | found)
        # With a margin of a tenth around the box of both masks.
        half = 0.6 * max(float(np.ptp(rows)), float(np.ptp(columns)), 1.0) + 1
        middle = np.array([(columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2])
        shown = image.copy()
        for part, color in ((found & ~frame.true, RED), (frame.true & ~found, GREEN)):
            shown[part] = ((1 - MASK_TINT) * shown[part] + MASK_TINT * np.array(color)).astype(np.uint8)
        scale = TILE_WIDTH_PX / (2 * half)
        warp = np.array([[scale, 0, TILE_WIDTH_PX / 2 - scale * middle[0]], [0, scale, TILE_WIDTH_PX / 2 - scale * middle[1]]])
        tile = cv2.warpAffine(shown, warp, (TILE_WIDTH_PX, TILE_WIDTH_PX), flags=cv2.INTER_LINEAR)
        write_label(tile, f"{frame.name} IoU {frame.overlap:.3f}")
        tiles.append(tile)
    return arrange_in_rows(tiles) if tiles else np.zeros((TILE_WIDTH_PX, TILE_WIDTH_PX, 3), np.uint8)


def undistort_mask(mask: np.ndarray, lens: dict | None) -> np.ndarray:
    """The (H, W) bool mask of a distorted image in the undistorted one; `lens` is that of the registration, None without distortion."""
    return undistort_by_lens(mask.astype(np.uint8), lens, cv2.INTER_NEAREST, cv2.BORDER_REPLICATE) > 0


def intersection_over_union(mask: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union of two (H, W) bool masks; 1 if both are empty.

    Raises:
        StepError: they have different sizes.
    """
    if mask.shape != other.shape:
        raise StepError(f"masks of {mask.shape[1]} x {mask.shape[0]} and {other.shape[1]} x {other.shape[0]} px cannot be compared")
    union = int((mask | other).sum())
    return float((mask & other).sum() / union) if union else 1.0
