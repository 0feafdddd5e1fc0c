"""Which cells of a grid cameras see, compiled: rays from the cells to the cameras through cells that are known to be free."""

from collections.abc import Sequence

import numba
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera

FREE = 1
"""The state of a cell that rays pass; all other states block them."""
SKIPPED_CELLS = 1.8
"""How far from its cell a ray starts: its own layer of measured or unknown cells does not hide a surface."""


@numba.njit(cache=True)
def find_visible(states, low, cell, targets, normals, least_cosine, rows, sizes, visible):
    """Fill (C, N) bool: which targets each camera has in its image, from the side that their normals point to, with nothing between.

    Args:
        states: (X, Y, Z) uint8 of the cells.
        low, cell: first corner of the grid (3,) and side of a cell.
        targets, normals: (N, 3) middles of cells and unit normals.
        least_cosine: of the angle between a normal and the direction to the camera.
        rows: (C, 16) of the cameras, as `Camera.row` has them.
        sizes: (C, 2) width and height of their images in pixels.
        visible: to fill.
    """
    for camera in range(len(rows)):
        row = rows[camera]
        for target in range(len(targets)):
            visible[camera, target] = _is_visible(
                states, low, cell, targets[target], normals[target], least_cosine, row, sizes[camera, 0], sizes[camera, 1]
            )


@numba.njit(cache=True, forceinline=True)
def _is_visible(states, low, cell, target, normal, least_cosine, row, width, height):
    px, py, pz = target[0], target[1], target[2]
    x = row[0] * px + row[1] * py + row[2] * pz + row[9]
    y = row[3] * px + row[4] * py + row[5] * pz + row[10]
    z = row[6] * px + row[7] * py + row[8] * pz + row[11]
    if z <= 0.0:
        return False
    column, line = x / z * row[12] + row[14], y / z * row[13] + row[15]
    if column < 0.0 or line < 0.0 or column >= width or line >= height:
        return False
    # From the target to the camera's centre, along the world's axes.
    dx = -(row[0] * x + row[3] * y + row[6] * z)
    dy = -(row[1] * x + row[4] * y + row[7] * z)
    dz = -(row[2] * x + row[5] * y + row[8] * z)
    length = (dx * dx + dy * dy + dz * dz) ** 0.5
    dx, dy, dz = dx / length, dy / length, dz / length
    if dx * normal[0] + dy * normal[1] + dz * normal[2] < least_cosine:
        return False
    at = SKIPPED_CELLS * cell
    while at < length:
        i, j, k = int((px + at * dx - low[0]) // cell), int((py + at * dy - low[1]) // cell), int((pz + at * dz - low[2]) // cell)
        if k < 0:
            return False
        if i < 0 or j < 0 or i >= states.shape[0] or j >= states.shape[1] or k >= states.shape[2]:
            return True
        if states[i, j, k] != FREE:
            return False
        at += cell
    return True


def see_cells(
    states: np.ndarray, low_m: np.ndarray, cell_m: float, targets_m: np.ndarray, normals: np.ndarray, least_cosine: float,
    cameras: Sequence[Camera],
) -> np.ndarray:  # fmt: skip
    """What `find_visible` fills for cameras in metres, (C, N) bool."""
    visible = np.zeros((len(cameras), len(targets_m)), np.bool_)
    camera_rows = [camera.row for camera in cameras]
    sizes_px = [(camera.width_px, camera.height_px) for camera in cameras]
    numbers = (np.ascontiguousarray(one, np.float64) for one in (low_m, targets_m, normals, camera_rows, sizes_px))
    low, targets, turned, rows, sizes = numbers
    if visible.size:
        find_visible(np.ascontiguousarray(states, np.uint8), low, float(cell_m), targets, turned, least_cosine, rows, sizes, visible)
    return visible
