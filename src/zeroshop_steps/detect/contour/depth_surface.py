"""Prepare a depth image: filled and smoothed depth, points, normals, and the large planes that are ground.

Planes are fitted in inverse depth, where a plane is an affine function of the pixel and the noise of a structured-light camera is
the same everywhere.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.alignment.robust_estimates import robust_deviation
from zeroshop_steps.geometry.observation.visibility import EDGE_ON_COSINE
from zeroshop_steps.runtime.errors import StepError

# Chosen on six virtual tables of the demo objects, the test set with seed 1 (docs/results.md, "Detection and poses").
FEWEST_MEASURED = 500  # pixels; an image with fewer shows no object
TRIALS, SAMPLES = 400, 4000  # of RANSAC: planes that are tried, and pixels that vote for them
DEGENERATE = 1e-3  # of the squared extent, twice the area of three pixels below which they fix no plane
PLANE_TOLERANCE = 0.006  # of the depth; a pixel closer to a plane votes for it: 6 mm at 1 m
LEAST_SHARE = 0.08  # of the measured pixels; planes with fewer are not looked for
NOISE_DEVIATIONS, LOWEST_MM = 5.0, 3.0  # a pixel stands on a plane if it is higher than both, in standard deviations and in mm
MEDIAN_PX, SMOOTHED_PX = 5, 2.0  # window of the median that removes single wrong depths, and the Gaussian before slopes are taken


@dataclass(frozen=True)
class DepthSurface:
    """A prepared depth image; all fields are (height, width).

    Attributes:
        measured: bool, where the camera gave a depth.
        depth_mm: float32 along the optical axis, smoothed; holes are filled with the farther depth on their left or right.
        points: (height, width, 3) float32 mm, camera frame.
        normals: (height, width, 3) float32, towards the camera.
        ground: bool, measured pixels on a plane that is larger than any side of an object.
    """

    measured: np.ndarray
    depth_mm: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    ground: np.ndarray


def prepare_surface(depth_mm: np.ndarray, intrinsics: np.ndarray, largest_mm: float, name: str) -> DepthSurface:
    """Prepare a measured depth image.

    Args:
        depth_mm: (height, width), 0 where there is none.
        intrinsics: (3, 3) BOP's K.
        largest_mm: diameter of the largest object to be detected.
        name: of the image, for messages.

    Raises:
        StepError: hardly anything was measured.
    """
    measured = depth_mm > 0
    if measured.sum() < FEWEST_MEASURED:
        raise StepError(f"the depth image of {name} has {measured.sum()} measured pixels; at least {FEWEST_MEASURED} are needed")
    filled = np.asarray(cv2.medianBlur(_fill_holes(depth_mm), MEDIAN_PX))
    inverse = cv2.GaussianBlur(np.asarray(1.0 / filled, np.float32), (0, 0), SMOOTHED_PX)
    height, width = depth_mm.shape
    rays = np.stack([*np.meshgrid(np.arange(width), np.arange(height)), np.ones((height, width))], -1) @ np.linalg.inv(intrinsics).T
    # 1/z = a x + b y + c in normalised coordinates is the plane a X + b Y + c Z = 1.
    slope_x = cv2.Sobel(inverse, cv2.CV_32F, 1, 0, ksize=3) / 8 * intrinsics[0, 0]
    slope_y = cv2.Sobel(inverse, cv2.CV_32F, 0, 1, ksize=3) / 8 * intrinsics[1, 1]
    rest = inverse - slope_x * rays[..., 0] - slope_y * rays[..., 1]
    normals = -np.stack([slope_x, slope_y, rest], -1)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
    ground = find_ground(depth_mm, intrinsics, largest_mm)
    return DepthSurface(measured, filled, (rays * filled[..., None]).astype(np.float32), normals.astype(np.float32), ground)


def _fill_holes(depth_mm: np.ndarray) -> np.ndarray:
    """Depth without holes. Most holes are shadows of the projector beside the camera, so they lie behind what casts the shadow."""
    rows, columns = np.indices(depth_mm.shape)
    measured, width = depth_mm > 0, depth_mm.shape[1]
    left = np.maximum.accumulate(np.where(measured, columns, -1), axis=1)
    right = np.minimum.accumulate(np.where(measured, columns, width)[:, ::-1], axis=1)[:, ::-1]
    sides = [np.where((side >= 0) & (side < width), depth_mm[rows, np.clip(side, 0, width - 1)], 0) for side in (left, right)]
    filled = np.maximum(*sides).astype(np.float32)
    empty = np.flatnonzero(~measured.any(1))
    full = np.flatnonzero(measured.any(1))
    filled[empty] = filled[full[np.abs(empty[:, None] - full).argmin(1)]]
    return filled


def find_ground(depth_mm: np.ndarray, intrinsics: np.ndarray, largest_mm: float) -> np.ndarray:
    """(height, width) bool: measured pixels on table, floor or wall: planes too large for a side of an object of `largest_mm`."""
    rows, columns = np.nonzero(depth_mm > 0)
    pixels = np.stack([columns, rows, np.ones(len(rows))], 1).astype(float)
    depths = depth_mm[rows, columns].astype(float)
    lengths = np.linalg.norm(pixels @ np.linalg.inv(intrinsics).T, axis=1)
    free = open_ = np.ones(len(rows), bool)
    while open_.mean() >= LEAST_SHARE:
        plane = _search_plane(pixels[open_], 1.0 / depths[open_])
        near = open_ & (np.abs(1.0 / depths - pixels @ plane) * depths < PLANE_TOLERANCE)
        if near.sum() < LEAST_SHARE * len(rows):
            break
        for _ in range(3):
            plane = np.linalg.lstsq(pixels[near], 1.0 / depths[near], rcond=None)[0]
            residual = 1.0 / depths - pixels @ plane
            spread = max(robust_deviation(residual[near]), 1e-9)
            near = open_ & (np.abs(residual) < NOISE_DEVIATIONS * spread)
        # In camera coordinates the plane is n . X = 1 with n = K' plane.
        steepness = np.linalg.norm(intrinsics.T @ plane)
        height_mm, noise_mm = residual * depths / steepness, spread * depths / steepness
        # A pixel covers depth^2 / (f_x f_y) of a plane across its ray, and more of an oblique one.
        cosines = np.clip(np.abs(pixels @ plane) / steepness / lengths, EDGE_ON_COSINE, 1)
        if (depths**2 / (intrinsics[0, 0] * intrinsics[1, 1] * cosines))[near].sum() > np.pi / 4 * largest_mm**2:
            free = free & (height_mm > np.maximum(LOWEST_MM, NOISE_DEVIATIONS * noise_mm))
        open_ = open_ & free & ~near
    ground = np.zeros(depth_mm.shape, bool)
    ground[rows[~free], columns[~free]] = True
    return ground


def _search_plane(pixels: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """(3,) the plane a u + b v + c = inverse depth with the most pixels close to it (RANSAC, Fischler and Bolles 1981)."""
    rng = np.random.default_rng(0)
    some = rng.choice(len(pixels), min(len(pixels), SAMPLES), replace=False)
    pixels, inverse = pixels[some], inverse[some]
    picks = np.stack([rng.choice(len(pixels), 3, replace=False) for _ in range(TRIALS)])
    corners = pixels[picks]
    solvable = np.abs(np.linalg.det(corners)) > DEGENERATE * np.ptp(pixels, axis=0).max() ** 2
    planes = np.linalg.solve(corners[solvable], inverse[picks[solvable], None])[..., 0]
    agreeing = (np.abs(pixels @ planes.T / inverse[:, None] - 1) < PLANE_TOLERANCE).sum(0)
    return planes[agreeing.argmax()]
