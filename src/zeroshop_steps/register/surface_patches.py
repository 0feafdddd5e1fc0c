"""Patches of a surface as an image shows them: the image is sampled along two axes that lie in the surface."""

import cv2
import numpy as np


def span_axes(normals: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(P, 2, 3) unit vectors in the planes of (P, 3) unit normals: nearest to a (3,) `right`, and the other, down, square to that."""
    along = right - normals * (normals @ right)[:, None]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([along, np.cross(normals, -along)], axis=1)


def cut_patch(image: np.ndarray, axes: np.ndarray, middle: np.ndarray, half_px: int) -> np.ndarray:
    """The (2 half + 1) squared patch around a pixel of an image; the (2, 2) `axes` map steps of the patch to steps of the image."""
    corner = middle - 0.5 - axes.sum(1) * half_px  # OpenCV's pixels have their centres at integers
    side = 2 * half_px + 1
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, np.column_stack([axes, corner]), (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE)
