"""Photos of an object on or beside a board of AprilTags or ChArUco: the board gives cameras, lens and metres.

All photos have one lens, which is calibrated by the board together with the cameras (Zhang 2000), so that it needs no other calibration.
A photo that shows too little of the board has no pose. Boards are those of `geometry/boards/board_files.py`, or a file that lists tags
anywhere:

    dictionary: 36h11
    tags: {0: [[0, 0, 0], [50, 0, 0], [50, 50, 0], [0, 50, 0]], ...}    # corners of each in mm, in one order all around
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from zeroshop_steps.capture.adapters.form import Adapter, GivenFrame, ImportedCapture, ImportOptions, read_size_px
from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.capture.photo_files import list_photos, open_picture
from zeroshop_steps.geometry.boards.board_files import find_dictionary, read_board
from zeroshop_steps.geometry.boards.printed_board import Board, TagBoard
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track

LEAST_CORNERS = 8  # of a photo that gets a pose: two tags
LEAST_PHOTOS = 5  # for a lens to be calibrated
MOST_ERROR_PX = 3.0  # per 1000 px of the image: root mean square of the corners, from which on the board is another one
OFF_MEDIANS = 5.0  # a photo whose corners are so many median errors off has a misread tag, or moved
ORDERS = [np.roll(order, turn) for order in (np.arange(4), np.arange(4)[::-1]) for turn in range(4)]
"""In which a maker may list a tag's corners."""


@dataclass(frozen=True)
class _Layout:
    """Tags and where their corners are: {id: (4, 3) mm}, in the order in which the detector lists them."""

    dictionary: int
    corners_mm: dict[int, np.ndarray]
    border_cells: int = 1

    def detect(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) corners on the board in mm and (N, 2) in an image, pixel (0, 0)'s centre at (0, 0)."""
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = self.border_cells
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        found, ids, _ = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(self.dictionary), parameters).detectMarkers(grey)
        known = [] if ids is None else [(int(i), one) for i, one in zip(ids.ravel(), found, strict=True) if int(i) in self.corners_mm]
        flat = [self.corners_mm[number] for number, _ in known]
        return np.array(flat).reshape(-1, 3), np.array([one for _, one in known]).reshape(-1, 2)


def read(folder: Path, options: ImportOptions) -> ImportedCapture:
    """All photos of a folder, those with enough of the board with a pose."""
    assert options.board is not None
    board = _read_layout(options.board)
    paths = list_photos(folder)[0]
    size_px, seen = read_size_px(paths[0]), {}
    for path in track(paths, "looking for the board", len(paths)):
        with open_picture(path) as image:
            if image.size != size_px:
                raise StepError(
                    f"{path} has {image.size[0]} x {image.size[1]} px, others {size_px[0]} x {size_px[1]} px; take all with one lens"
                )
            flat, pixels = _detect(board, np.asarray(image.convert("L")))
        if len(flat) >= LEAST_CORNERS:
            seen[path] = flat, pixels
    if len(seen) < LEAST_PHOTOS:
        raise StepError(
            f"{len(seen)} of {len(paths)} photos in {folder} show {LEAST_CORNERS} corners of the board {options.board}, {LEAST_PHOTOS} are"
            " needed; check its dictionary, and that its tags are sharp and not cut off"
        )
    error_px, lens, poses = _calibrate(board, seen, size_px)
    if error_px > MOST_ERROR_PX * max(size_px) / 1000:
        raise StepError(
            f"the corners of the board {options.board} miss the photos in {folder} by {error_px:.1f} px: it is another board, its lengths"
            " differ, it is not flat, or the photos were taken with several lenses"
        )
    frames = [GivenFrame(path, lens, poses.get(path)) for path in paths]
    warnings = []
    if len(poses) < len(paths):
        missing = ", ".join(path.name for path in paths if path not in poses)
        warnings.append(f"{len(paths) - len(poses)} of {len(paths)} photos show too little of the board to have a pose: {missing}")
    return ImportedCapture(frames, f"board {options.board} ({error_px:.2f} px)", 0.001, tuple(warnings))


def _read_layout(name: str) -> Board | _Layout:
    path = Path(name)
    content: Any = None
    if path.is_file():
        try:
            content = yaml.safe_load(path.read_text())
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise StepError(f"{path} cannot be read as YAML ({str(error).splitlines()[0]}); correct it") from None
    if isinstance(content, dict) and isinstance(content.get("tags"), dict):
        try:
            corners = {int(number): np.array(one, float).reshape(4, -1) for number, one in content["tags"].items()}
            corners = {number: np.pad(one, ((0, 0), (0, 3 - one.shape[1]))) for number, one in corners.items()}
        except (TypeError, ValueError) as error:
            raise StepError(f"{path}: each of its tags must have 4 corners of 2 or 3 numbers, in mm ({error})") from None
        return _Layout(find_dictionary(name, str(content.get("dictionary", ""))), corners)
    board = read_board(name)
    if isinstance(board, TagBoard):
        if board.kind != "grid":
            raise StepError(
                f"the board {name} is of kind {board.kind}, which says not where its tags lie; list their corners in a file (tags)"
            )
        corners = {board.first_id + number: one for number, one in enumerate(board.corners_mm().reshape(-1, 4, 3))}
        return _Layout(board.dictionary, corners, board.border_cells)
    return board


def _detect(board: Board | _Layout, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(board, _Layout):
        return board.detect(grey)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board.charuco).detectBoard(grey)
    if numbers is None or not len(numbers):
        return np.zeros((0, 3)), np.zeros((0, 2))
    return board.corners_mm()[np.asarray(numbers).ravel()], np.asarray(corners, float).reshape(-1, 2)


def _calibrate(
    board: Board | _Layout, seen: dict[Path, tuple[np.ndarray, np.ndarray]], size_px: tuple[int, int]
) -> tuple[float, Lens, dict[Path, np.ndarray]]:
    """Root mean square of the errors in pixels, the lens, and camera_from_board in mm of the photos that fit."""
    orders: Iterable[np.ndarray] = ORDERS if isinstance(board, _Layout) else [np.arange(1)]
    best = min((_fit(seen, size_px, order) for order in orders), key=lambda fit: fit[0])
    off = best[3]
    kept = [path for path in seen if off[path] <= OFF_MEDIANS * float(np.median(list(off.values())))]
    if LEAST_PHOTOS <= len(kept) < len(seen):
        best = _fit({path: seen[path] for path in kept}, size_px, best[4])
    half = np.array([0.0, 0.0, 0.5, 0.5])
    intrinsics, distortion = best[1]
    params = np.array([intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]]) + half
    return best[0], Lens("OPENCV", *size_px, tuple(map(float, [*params, *distortion[:4]]))), best[2]


def _fit(seen: dict[Path, tuple[np.ndarray, np.ndarray]], size_px: tuple[int, int], order: np.ndarray) -> tuple:
    """Error, (K, distortion), poses, error by photo, and the order in which tags' corners were taken."""
    count = len(order)
    flats = [flat.reshape(-1, count, 3)[:, order].reshape(-1, 3).astype(np.float32) for flat, _ in seen.values()]
    pixels = [one.astype(np.float32) for _, one in seen.values()]
    start = np.array([[max(size_px), 0, size_px[0] / 2], [0, max(size_px), size_px[1] / 2], [0, 0, 1.0]])
    # Pixels are square, and lenses centred: free, both would follow the noise of few photos from one height.
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST
    found = cv2.calibrateCameraExtended(flats, pixels, size_px, start, np.zeros(5), flags=flags)
    error, intrinsics, distortion, turns, shifts, _, _, errors = found
    poses = {}
    for path, turn, shift in zip(seen, turns, shifts, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
        poses[path] = pose
    return error, (intrinsics, distortion.ravel()), poses, dict(zip(seen, map(float, errors.ravel()), strict=True)), order


ADAPTER = Adapter("photos with a board of AprilTags or ChArUco", "zeroshop import PHOTOS --board BOARD", lambda folder: False, read, 20)
