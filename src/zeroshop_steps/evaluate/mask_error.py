"""Judge masks of a rendered film by the true ones: their intersection over union in every frame that was taken from it.

Only this step reads the true masks. They are brought to the undistorted photos by the lens that the registration found.
Writes a tidy CSV: a row for every frame, empty where it was left out, and rows of camera `all`; beside it a picture of the worst.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.capture.frames import SHEET_COLUMNS, TILE_WIDTH_PX, arrange_in_rows
from zeroshop_steps.geometry.images import read_image, read_mask, write_image
from zeroshop_steps.register.record import read_registration
from zeroshop_steps.register.undistort import make_undistortion_map
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.tables import write_table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--cameras", type=Path, required=True, help="folder that a segmentation wrote")
    parser.add_argument("--capture", type=Path, required=True, help="the film's capture: it says which frames were taken")
    parser.add_argument("--truth", type=Path, required=True, help="the film's truth: masks/ of all its frames")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write; the picture goes beside it as .png")


@dataclass(frozen=True)
class FrameMasks:
    """A frame that was taken from the film.

    Attributes:
        name: its stem.
        true: (H, W) bool mask, undistorted.
        found: (H, W) bool mask; None where the frame was left out.
    """

    name: str
    true: np.ndarray
    found: np.ndarray | None

    @property
    def overlap(self) -> float | None:
        """Intersection over union."""
        return None if self.found is None else intersection_over_union(self.found, self.true)


def run(args: argparse.Namespace) -> None:
    """Write the CSV and the picture."""
    frames = read_frame_masks(args.cameras, args.capture, args.truth)
    overlaps = {frame.name: frame.overlap for frame in frames}
    found = np.array([overlap for overlap in overlaps.values() if overlap is not None])
    summary = {"masks": len(found), "left_out": len(overlaps) - len(found)}
    if len(found):
        summary |= {"iou_median": round(float(np.median(found)), 4), "iou_min": round(float(found.min()), 4)}
    rows = [{"camera": "all", "measure": key, "value": value} for key, value in summary.items()]
    for name, overlap in overlaps.items():
        rows.append({"camera": name, "measure": "iou", "value": None if overlap is None else round(overlap, 4)})
    write_table(args.out, rows)
    worst = sorted((frame for frame in frames if frame.found is not None), key=lambda frame: frame.overlap)[:SHEET_COLUMNS]
    images = [read_image(args.cameras / "images" / f"{frame.name}.png") for frame in worst]
    write_image(args.out.with_suffix(".png"), draw_mask_errors(worst, images))


def read_frame_masks(cameras: Path, capture: Path, truth: Path) -> list[FrameMasks]:
    """The frames of a capture with their masks.

    Raises:
        StepError: the registration or the segmentation failed, or the capture was not taken from this film.
    """
    lens = read_registration(cameras).get("lens")
    frames = read_json(capture / "capture.json").get("source_frames")
    if frames is None:
        raise StepError(f"{capture / 'capture.json'} names no source_frames; only captures of a video can be judged by a film's truth")
    judged = []
    for index, number in enumerate(frames):
        path = cameras / "masks" / f"{index:06d}.png"
        true = undistort_mask(read_mask(truth / "masks" / f"{number:06d}.png"), lens)
        judged.append(FrameMasks(path.stem, true, read_mask(path) if path.is_file() else None))
    return judged


def draw_mask_errors(frames: list[FrameMasks], images: list[np.ndarray]) -> np.ndarray:
    """(H, W, 3) uint8: the object in each frame, red where the mask is too large, green where it lacks something."""
    tiles = []
    for frame, image in zip(frames, images, strict=True):
        rows, columns = np.nonzero(frame.true | frame.found)
        half = 0.6 * max(np.ptp(rows), np.ptp(columns), 1) + 1
        middle = np.array([(columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2])
        shown = image.copy()
        for part, color in ((frame.found & ~frame.true, (255, 0, 0)), (frame.true & ~frame.found, (0, 255, 0))):
            shown[part] = (0.4 * shown[part] + 0.6 * np.array(color)).astype(np.uint8)
        scale = TILE_WIDTH_PX / (2 * half)
        warp = np.array([[scale, 0, TILE_WIDTH_PX / 2 - scale * middle[0]], [0, scale, TILE_WIDTH_PX / 2 - scale * middle[1]]])
        tile = cv2.warpAffine(shown, warp, (TILE_WIDTH_PX, TILE_WIDTH_PX), flags=cv2.INTER_LINEAR)
        label = f"{frame.name} IoU {frame.overlap:.3f}"
        cv2.putText(tile, label, (5, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(tile)
    return arrange_in_rows(tiles) if tiles else np.zeros((TILE_WIDTH_PX, TILE_WIDTH_PX, 3), np.uint8)


def undistort_mask(mask: np.ndarray, lens: dict | None) -> np.ndarray:
    """An (H, W) bool mask of the picture as it was taken, in the undistorted one; `lens` is the registration's."""
    if not lens:
        return mask
    camera = pycolmap.Camera(model=lens["model"], width=lens["width_px"], height=lens["height_px"], params=lens["params"])
    map_x, map_y = make_undistortion_map(camera)[1]
    return cv2.remap(mask.astype(np.uint8), map_x, map_y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE) > 0


def intersection_over_union(mask: np.ndarray, other: np.ndarray) -> float:
    """Of two (H, W) bool masks; 1 where both are empty.

    Raises:
        StepError: of different sizes.
    """
    if mask.shape != other.shape:
        raise StepError(f"masks of {mask.shape[1]} x {mask.shape[0]} and {other.shape[1]} x {other.shape[0]} px cannot be compared")
    union = int((mask | other).sum())
    return float((mask & other).sum() / union) if union else 1.0
