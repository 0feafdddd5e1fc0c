"""How strongly an image's pixels look like the border of an object, by what tells so: depth, concave creases, creases, colour."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.detect.contour.depth_surface import DepthSurface

STEP_PX = 2  # a jump of depth is looked for over this half distance
CREASE_PX = 5  # and a change of the normal over this one
JUMP_MM, NOISE_OF_DEPTH2 = 5.0, 6e-6  # a full edge: this jump, more where the noise, which grows with squared depth, hides it
COLOR = 24.0  # of Lab over the half distance
DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True)
class Edges:
    """Strengths of every pixel, (height, width) float32 each.

    Attributes:
        jump: depth jumps; 0..1.
        concave: the surface bends inwards, as where two things touch; 0..2, the difference of unit normals.
        convex: it bends outwards, as at a box's edge; 0..2.
        color: the colour changes; 0..1.
    """

    jump: np.ndarray
    concave: np.ndarray
    convex: np.ndarray
    color: np.ndarray


def detect_edges(surface: DepthSurface, lab: np.ndarray) -> Edges:
    """Edges of one image; `lab` is (height, width, 3) float32."""
    smooth = cv2.GaussianBlur(lab, (0, 0), 1.0)
    shape = surface.depth_mm.shape
    jump, concave, convex, color = (np.zeros(shape, np.float32) for _ in range(4))
    for row, column in DIRECTIONS:
        step = np.array([row, column])
        first, before, after, last = (_shift(surface.depth_mm, number * STEP_PX * step) for number in (-3, -1, 1, 3))
        # What the slopes on both sides explain is no jump.
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
    """`values` at the pixels `offset` (rows, columns) further; the border repeats."""
    margin = int(np.abs(offset).max())
    padded = np.pad(values, [(margin, margin)] * 2 + [(0, 0)] * (values.ndim - 2), mode="edge")
    row, column = margin + offset
    return padded[row : row + values.shape[0], column : column + values.shape[1]]
