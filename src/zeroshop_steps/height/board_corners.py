"""Detect the corners of a printed board in photos whose cameras are known."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from zeroshop_steps.geometry.boards.board_files import BOARDS
from zeroshop_steps.geometry.boards.printed_board import DICTIONARY, Board, TagBoard
from zeroshop_steps.height.board_view import BoardView
from zeroshop_steps.height.tag_boards import check_tag_views, detect_tag_corners
from zeroshop_steps.runtime.errors import StepError

LEAST_IN_A_PHOTO = 4  # corners; a photo with fewer is left out, since four define a homography
LEAST_CORNERS = 8  # that at least two photos must show
LEAST_SQUARE_PX = 10.0  # side of a square in the photo that shows it largest; markers in smaller ones cannot be read
BEYOND_A_SQUARE = 0.35  # a corner this far, in squares, from where the homography puts it was mistaken for another
LEAST_MARKERS = 2  # of a board, for a photo to show it: single markers are misread
ToRays = Callable[[np.ndarray], np.ndarray]


def detect_corners(image: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """(N,) numbers and (N, 2) pixels (pixel (0, 0)'s centre is (0.5, 0.5)) of the board's corners in a (height, width, 3) photo."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board.charuco).detectBoard(grey)
    if numbers is None or len(numbers) < LEAST_IN_A_PHOTO:
        return np.zeros(0, int), np.zeros((0, 2))
    numbers, corners = np.asarray(numbers).reshape(-1).astype(int), np.asarray(corners, float).reshape(-1, 2)
    # The board is flat, and lenses distort little over it: corners that were mistaken do not fit a homography.
    flat = board.corners_mm()[numbers, :2]
    homography, kept = cv2.findHomography(flat, corners, cv2.RANSAC, BEYOND_A_SQUARE * _measure_square_px(numbers, corners, board))
    if homography is None or kept.sum() < LEAST_IN_A_PHOTO:
        return np.zeros(0, int), np.zeros((0, 2))
    kept = kept.reshape(-1).astype(bool)
    return numbers[kept], corners[kept] + 0.5


def detect_board(
    name: str, image: np.ndarray, board: Board | TagBoard, to_rays: ToRays, camera_from_world: np.ndarray, focal_px: float
) -> BoardView | None:
    """The corners in a photo, None where there are too few; `to_rays` turns (N, 2) pixels into (N, 2) rays."""
    if isinstance(board, TagBoard):
        numbers, pixels, square_px = detect_tag_corners(image, board)
    else:
        numbers, pixels = detect_corners(image, board)
        square_px = _measure_square_px(numbers, pixels, board)
    return BoardView(name, numbers, to_rays(pixels), camera_from_world, focal_px, square_px) if len(numbers) else None


def check_board_views(views: Sequence[BoardView], board: Board | TagBoard, images: Sequence[np.ndarray], where: str) -> None:
    """Raise StepError where the photos show no board, another one, or too little of it.

    Args:
        views: the photos that show it.
        board: the board that is expected.
        images: some of the photos, to look for other boards in.
        where: names the photos in messages.
    """
    if isinstance(board, TagBoard):
        check_tag_views(views, board, where)
        return
    if not views:
        other = next((name for name in (identify_board(image) for image in images) if name and name != board.name), None)
        if other:
            raise StepError(f"{where} show the board {other}, not {board.name}; give height.marker.board the board that was printed")
        raise StepError(
            f"{where} show no board {board.name} that could be read: it is too small or blurred there, cut off, or not in them. "
            f"Its squares must be at least {LEAST_SQUARE_PX:g} px wide and {LEAST_IN_A_PHOTO} corners inside it in one photo"
        )
    counts = np.bincount(np.concatenate([view.numbers for view in views]), minlength=len(board.corners_mm()))
    shared = int((counts >= 2).sum())
    if len(views) < 2 or shared < LEAST_CORNERS:
        raise StepError(
            f"the board is cut off or hidden: {len(views)} of {where} show it, and only {shared} of its {len(counts)} corners are in two "
            f"or more of them, {LEAST_CORNERS} are needed; show more of the board in more photos"
        )
    widest_px = max(view.square_px for view in views)
    if widest_px < LEAST_SQUARE_PX:
        raise StepError(
            f"the board is too small in {where}: its squares are {widest_px:.0f} px wide at most, {LEAST_SQUARE_PX:g} are needed"
        )


def identify_board(image: np.ndarray) -> str | None:
    """The name of the board whose markers a photo shows most of, None without any."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY)
    _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    found = [] if ids is None else np.asarray(ids).reshape(-1).tolist()
    counts = {name: sum(number in board.ids for number in found) for name, board in BOARDS.items()}
    best = max(counts, key=lambda name: counts[name])
    return best if counts[best] >= LEAST_MARKERS else None


def _measure_square_px(numbers: np.ndarray, pixels: np.ndarray, board: Board) -> float:
    """Median distance in pixels of corners that are neighbours on the board; 0 where no two are."""
    place = {int(number): pixel for number, pixel in zip(numbers, pixels, strict=True)}
    across = board.columns - 1
    sides = [
        np.linalg.norm(place[other] - pixel)
        for number, pixel in place.items()
        for other in ([number + 1] if (number + 1) % across else []) + [number + across]
        if other in place
    ]
    return float(np.median(sides)) if sides else 0.0
