"""Detect tags of a known size or distance in photos whose cameras are known, and measure the scale by them."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from zeroshop_steps.geometry.boards.printed_board import TagBoard
from zeroshop_steps.height.board_fit import BoardFit, fit_board, triangulate_corners
from zeroshop_steps.height.board_view import BoardView
from zeroshop_steps.runtime.errors import StepError

LEAST_SIDE_PX = 20.0  # of a tag in the photo that shows it largest
CORNER_PX = 0.3  # standard deviation of a corner in a photo
BEYOND_A_TAG = 0.2  # a corner this far, in sides of a tag, from where the homography puts it was mistaken for another


def detect_tag_corners(image: np.ndarray, board: TagBoard) -> tuple[np.ndarray, np.ndarray, float]:
    """Corners of the board's tags in a (height, width, 3) photo.

    Returns:
        numbers: (N,) of a grid, indices into `corners_mm`; of tags, four times the id and more; of a bar, 0 and 1, the tags' centres.
        pixels: (N, 2), the centre of pixel (0, 0) at (0.5, 0.5).
        side_px: median side of a tag; 0 without any.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = board.border_cells
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(board.dictionary), parameters)
    corners, ids, _ = detector.detectMarkers(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    found = {} if ids is None else {int(number): one.reshape(4, 2).astype(float) for number, one in zip(ids.ravel(), corners, strict=True)}
    wanted = range(board.first_id, board.first_id + board.columns * board.rows)
    known = {"bar": board.ids, "grid": wanted}.get(board.kind, found)
    found = {number: one for number, one in found.items() if number in known}
    if not found:
        return np.zeros(0, int), np.zeros((0, 2)), 0.0
    side_px = float(np.median([np.linalg.norm(one - np.roll(one, 1, 0), axis=1).mean() for one in found.values()]))
    if board.kind == "bar":
        numbers = np.array([board.ids.index(number) for number in found])
        return numbers, np.array([_find_centre(one) for one in found.values()]) + 0.5, side_px
    first = np.array([4 * (number - board.first_id) for number in found])
    pixels = np.array(list(found.values()))
    if board.kind == "tags":
        return (first[:, None] + np.arange(4)).ravel(), pixels.reshape(-1, 2) + 0.5, side_px
    return *_match_grid(board, first, pixels, side_px), side_px


def _find_centre(corners: np.ndarray) -> np.ndarray:
    """Where the diagonals of a tag meet: its centre also in perspective."""
    lines = np.array([np.cross([*corners[start], 1.0], [*corners[start + 2], 1.0]) for start in (0, 1)])
    meeting = np.cross(*lines)
    return meeting[:2] / meeting[2]


def _match_grid(board: TagBoard, first: np.ndarray, pixels: np.ndarray, side_px: float) -> tuple[np.ndarray, np.ndarray]:
    """The corners that fit the grid, whichever corner of a tag its maker calls the first."""
    best = (np.zeros(0, int), np.zeros((0, 2)))
    flat = board.corners_mm()[:, :2]
    for turn in range(4 if len(first) > 1 else 1):
        numbers = (first[:, None] + (np.arange(4) + turn) % 4).ravel()
        homography, kept = cv2.findHomography(flat[numbers], pixels.reshape(-1, 2), cv2.RANSAC, BEYOND_A_TAG * side_px)
        fitting = np.zeros(len(numbers), bool) if homography is None else kept.ravel().astype(bool)
        if fitting.sum() > len(best[0]):
            best = numbers[fitting], pixels.reshape(-1, 2)[fitting] + 0.5
    return best


def check_tag_views(views: Sequence[BoardView], board: TagBoard, where: str) -> None:
    """Raise StepError where no two photos show the same tag, or, of a bar, both; or where the tags are too small."""
    if not views:
        raise StepError(f"{where} show no tag of the board {board.name}; check its dictionary, and that tags are sharp and not cut off")
    numbers = np.concatenate([view.numbers for view in views])
    twice = {int(number) for number in np.unique(numbers) if (numbers == number).sum() >= 2}
    if len(twice) < (2 if board.kind == "bar" else 4):
        needed = "both tags of the bar" if board.kind == "bar" else "a whole tag"
        raise StepError(f"{len(views)} of {where} show tags of the board {board.name}, but no two of them {needed}; show it in more photos")
    widest_px = max(view.square_px for view in views)
    if widest_px < LEAST_SIDE_PX:
        raise StepError(f"the tags are too small in {where}: {widest_px:.0f} px wide at most, {LEAST_SIDE_PX:g} are needed; go nearer")


def fit_tags(board: TagBoard, views: Sequence[BoardView]) -> BoardFit:
    """The scale by a grid, by tags of one size, or by a bar. Raises StepError as `fit_board` does."""
    if board.kind == "grid":
        return fit_board(board, views)
    if board.kind == "bar":
        return _fit_bar(board, views)
    fits, reason = [], None
    alone = replace(board, kind="grid", columns=1, rows=1)
    for tag in sorted({int(number) // 4 for view in views for number in view.numbers}):
        parts = [(view, view.numbers // 4 == tag) for view in views]
        seen = [replace(view, numbers=view.numbers[of] % 4, rays=view.rays[of]) for view, of in parts if of.any()]
        try:
            fits += [fit_board(alone, seen)] if len(seen) > 1 else []
        except StepError as error:
            reason = error
    if not fits:
        raise reason or StepError(f"no tag of the board {board.name} is in two photos; show it in more")
    scales = np.array([fit.units_per_mm for fit in fits])
    middle = float(np.median(scales))
    deviation = float(np.hypot(np.median([fit.deviation for fit in fits]), scales.std() / middle) / np.sqrt(len(fits)))
    return BoardFit(
        middle, deviation, 1.0, float(np.median([fit.residual_px for fit in fits])), sum(fit.corners for fit in fits), len(views)
    )


def _fit_bar(board: TagBoard, views: Sequence[BoardView]) -> BoardFit:
    """The distance of two triangulated centres."""
    ends = triangulate_corners(views, 2)
    if not np.isfinite(ends).all():
        raise StepError("the photos that show the bar were taken from nearly one place; move the camera around it between them")
    length = float(np.linalg.norm(ends[1] - ends[0]))
    errors_px, lengths_px = [], []
    for view in views:
        points = ends @ view.camera_from_world[:3, :3].T + view.camera_from_world[:3, 3]
        places = points[:, :2] / points[:, 2:] * view.focal_px
        errors_px += np.linalg.norm(places[view.numbers] - view.rays * view.focal_px, axis=1).tolist()
        lengths_px.append(float(np.linalg.norm(places[1] - places[0])))
    residual_px = float(np.median(errors_px))
    deviation = max(residual_px, CORNER_PX) * np.sqrt(2.0 / len(views)) / float(np.median(lengths_px))
    return BoardFit(length / board.distance_mm, float(deviation), 1.0, residual_px, 2, len(views))
