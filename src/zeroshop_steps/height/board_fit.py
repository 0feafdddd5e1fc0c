"""Measure the size of a printed board in a registration.

The corners are triangulated from the views (direct linear transform; Hartley and Zisserman 2004, section 12.2), a similarity from
the board to them is fitted (Umeyama 1991), and refined by the reprojection errors in all photos under a robust loss. Leaving out
one photo at a time tells how uncertain it is (jackknife; Tukey 1958).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.alignment.robust_estimates import robust_deviation
from zeroshop_steps.geometry.boards.printed_board import Board, TagBoard
from zeroshop_steps.geometry.cameras.pinhole import LEAST_PAIRS, fit_similarity_robustly
from zeroshop_steps.height.board_view import BoardView
from zeroshop_steps.runtime.errors import StepError

LARGEST_PX = 4.0  # median residual from which on board and cameras contradict each other
LARGEST_STRETCH = 0.02  # of height to width of the print; more was fitted to another page size
LEAST_ANGLE_DEG = 1.0  # between the rays to a corner; its depth is too uncertain below
LEAST_CORNERS = LEAST_PAIRS + 1  # triangulated ones, that define the fit and check it


@dataclass(frozen=True)
class BoardFit:
    """A board, fitted to its corners in the photos.

    Attributes:
        units_per_mm: its scale in the registration.
        deviation: relative standard deviation of that.
        stretch: height to width of the print, compared with the board's; 1 where it was not stretched.
        residual_px: median reprojection error of a corner.
        corners, photos: how many were used.
    """

    units_per_mm: float
    deviation: float
    stretch: float
    residual_px: float
    corners: int
    photos: int


def fit_board(board: Board | TagBoard, views: Sequence[BoardView]) -> BoardFit:
    """Fit the board to at least two views of it.

    Raises:
        StepError: the cameras stand too close together, the board moved or is bent, or the print is stretched.
    """
    corners = board.corners_mm()
    triangulated = triangulate_corners(views, len(corners))
    known = np.isfinite(triangulated).all(1)
    if known.sum() < LEAST_CORNERS:
        raise StepError("the photos that show the board were taken from nearly one place; move the camera around it between them")
    start, _ = fit_similarity_robustly(corners[known], triangulated[known])
    linear = start[:3, :3]
    size = np.cbrt(np.linalg.det(linear))
    seed = np.r_[np.log(size), Rotation.from_matrix(linear / size).as_rotvec(), start[:3, 3], 0.0]
    seed = _refine(seed, corners, views, stretched=False)
    residual_px = float(np.median(np.linalg.norm(_compute_residuals(seed, corners, views).reshape(-1, 2), axis=1)))
    if residual_px > LARGEST_PX:
        raise StepError(
            f"the board's corners miss their places by {residual_px:.1f} px: it moved between the photos, is bent, or the cameras are "
            "wrong; lay it flat, leave it where it is, and take the photos again"
        )
    stretch = float(np.exp(_refine(seed, corners, views, stretched=True)[7]))
    if abs(stretch - 1.0) > LARGEST_STRETCH:
        raise StepError(
            f"the board was printed out of shape: its height to width is {100 * (stretch - 1):+.1f} % off. It is of another size than the "
            "PDF; print it again at 100 %"
        )
    return BoardFit(
        float(np.exp(seed[0])), _estimate_deviation(seed, corners, views, triangulated), stretch, residual_px, int(known.sum()), len(views)
    )


def triangulate_corners(views: Sequence[BoardView], count: int) -> np.ndarray:
    """(count, 3) corners in the world frame; NaN where fewer than two views, or rays too parallel, show one."""
    points = np.full((count, 3), np.nan)
    for number in range(count):
        seen = [(view, view.rays[view.numbers == number][0]) for view in views if number in view.numbers]
        if len(seen) < 2:
            continue
        rows = [ray[:, None] * view.camera_from_world[2] - view.camera_from_world[:2] for view, ray in seen]
        solution = np.linalg.svd(np.concatenate(rows))[2][-1]
        if abs(solution[3]) < 1e-12:
            continue
        point = solution[:3] / solution[3]
        directions = np.array([point + view.camera_from_world[:3, :3].T @ view.camera_from_world[:3, 3] for view, _ in seen])
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        if np.degrees(np.arccos(np.clip((directions @ directions.T).min(), -1.0, 1.0))) > LEAST_ANGLE_DEG:
            points[number] = point
    return points


def _refine(start: np.ndarray, corners: np.ndarray, views: Sequence[BoardView], stretched: bool) -> np.ndarray:
    """The parameters (log scale, rotation vector, shift, log stretch) with the least reprojection errors."""
    free = 8 if stretched else 7
    unit = np.r_[1.0, 1.0, 1.0, 1.0, np.full(3, np.exp(start[0]) * 100.0), 1.0]  # a shift of 100 mm is as much as a radian

    def cost(change: np.ndarray) -> np.ndarray:
        return _compute_residuals(start + unit * np.r_[change, np.zeros(8 - free)], corners, views)

    found = least_squares(cost, np.zeros(free), loss="soft_l1", f_scale=0.5, max_nfev=100)
    return start + unit * np.r_[found.x, np.zeros(8 - free)]


def _compute_residuals(parameters: np.ndarray, corners: np.ndarray, views: Sequence[BoardView]) -> np.ndarray:
    """(2 N,) reprojection errors in pixels, x and y, of all detected corners."""
    shape = np.array([np.exp(-parameters[7] / 2), np.exp(parameters[7] / 2), 1.0])
    world = np.exp(parameters[0]) * (corners * shape) @ Rotation.from_rotvec(parameters[1:4]).as_matrix().T + parameters[4:7]
    parts = []
    for view in views:
        points = world[view.numbers] @ view.camera_from_world[:3, :3].T + view.camera_from_world[:3, 3]
        parts.append((points[:, :2] / np.maximum(points[:, 2:], 1e-9) - view.rays) * view.focal_px)
    return np.concatenate(parts).ravel()


def _estimate_deviation(parameters: np.ndarray, corners: np.ndarray, views: Sequence[BoardView], triangulated: np.ndarray) -> float:
    """Standard deviation of the log scale: by the jackknife over three photos or more, and from distances between triangulated corners."""
    known = np.flatnonzero(np.isfinite(triangulated).all(1))
    first, second = np.triu_indices(len(known), 1)
    ratios = np.linalg.norm(triangulated[known[first]] - triangulated[known[second]], axis=1)
    ratios /= np.linalg.norm(corners[known[first]] - corners[known[second]], axis=1)
    spread = robust_deviation(ratios / np.median(ratios) - 1.0) / np.sqrt(len(known))
    if len(views) < 3:
        return float(spread)
    without = [_refine(parameters, corners, [*views[:k], *views[k + 1 :]], stretched=False)[0] for k in range(len(views))]
    jackknife = np.sqrt((len(views) - 1) / len(views) * np.sum((np.array(without) - np.mean(without)) ** 2))
    return float(np.hypot(jackknife, spread))
