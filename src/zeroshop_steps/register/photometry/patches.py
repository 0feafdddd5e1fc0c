"""Patches of a surface as an image shows them: the image is sampled along two axes that lie in the surface."""

from collections.abc import Callable

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


def compare_patches(
    grey: np.ndarray,
    carried: np.ndarray,
    whole: np.ndarray,
    patch_px: int,
    play_px: int,
    least_contrast: float,
    tells: Callable[[np.ndarray, int, int], bool] = lambda patch, row, column: True,
) -> np.ndarray:
    """(P,) normalized cross-correlation of textured patches on a grid, each at its best place within the play.

    Args:
        grey, carried: (H, W) float32 pictures of one place.
        whole: (H, W) bool, where a patch of both lies on the object.
        patch_px, play_px: side of a patch, an odd number, and how far it may lie beside its place.
        least_contrast: standard deviation of the grey of a patch that is compared.
        tells: whether a patch, by itself and its place (row, column), is worth comparing.
    """
    half = patch_px // 2
    reach = half + play_px
    scores = []
    for row in range(reach, grey.shape[0] - reach, half + 1):
        for column in range(reach, grey.shape[1] - reach, half + 1):
            patch = grey[row - half : row + half + 1, column - half : column + half + 1]
            if whole[row, column] and patch.std() >= least_contrast and tells(patch, row, column):
                window = carried[row - reach : row + reach + 1, column - reach : column + reach + 1]
                scores.append(float(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED).max()))
    return np.array(scores)
