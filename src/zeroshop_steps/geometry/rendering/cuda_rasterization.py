"""Rasterization of a mesh on a CUDA device, a thread for each face. See rasterization_kernel.py.

A thread notes depth and face of a pixel as one number, the largest of which is kept, so the result has the same bytes every run.

Without a GPU, Numba's simulator runs these kernels (NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

from typing import Any

import numpy as np
from numba import cuda

from zeroshop_steps.geometry.rendering.rasterization_kernel import find_pixels, read_corners, share_pixel, weigh_corners
from zeroshop_steps.runtime.compute.device_arrays import THREADS, blocks_of_threads

LAST_FACE = 0x7FFFFFFF
"""Faces are noted by how far they are before it, so that of two at the same depth the first is kept."""


class CudaFaces:
    """The faces of a mesh on a device, for pictures from many sides."""

    def __init__(self, faces: np.ndarray) -> None:
        self._faces = cuda.to_device(np.ascontiguousarray(faces, np.int32))

    def draw(self, pixels: np.ndarray, depths: np.ndarray, nearest_depth: float, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """What `rasterization_kernel.draw_faces` returns, for one picture of this shape (H, W).

        Args:
            pixels: (V, 2) float32, columns and rows of the vertices.
            depths: (V,) float32.
            nearest_depth: faces with a corner no farther away are left out.
            shape: height and width of the picture.
        """
        kept = cuda.to_device(np.zeros((1, *shape), np.int64))
        keep_nearest_faces(cuda.to_device(pixels[None]), cuda.to_device(depths[None]), self._faces, nearest_depth, kept)
        found = np.asarray(kept.copy_to_host())[0]
        return (found >> 32).astype(np.int32).view(np.float32), np.where(found > 0, LAST_FACE - (found & LAST_FACE), -1).astype(np.int32)


def keep_nearest_faces(pixels: Any, depths: Any, faces: Any, nearest_depth: float, kept: Any) -> None:
    """Note the nearest face of each pixel of P pictures: inverse depth in the upper half, `LAST_FACE` less the face in the lower one.

    Args:
        pixels, depths: (P, V, 2) and (P, V) float32 on the device, as `rasterization_kernel.draw_nearest` takes them.
        faces: (F, 3) int32.
        nearest_depth: faces with a corner no farther away are left out.
        kept: (P, H, W) int64 zeros to fill.
    """
    _keep_nearest[blocks_of_threads(len(pixels) * len(faces)), THREADS](pixels, depths, faces, np.float32(nearest_depth), kept)


def share_corners(pixels: Any, depths: Any, faces: Any, kept: Any, shares: Any) -> None:
    """Fill (P, H, W, 3) float32 zeros with the shares of the corners of the faces that `keep_nearest_faces` noted."""
    _share_corners[blocks_of_threads(kept.size), THREADS](pixels, depths, faces, kept, shares)


@cuda.jit
def _keep_nearest(pixels, depths, faces, nearest_depth, kept):
    """Keep, for each pixel, the bits of the largest inverse depth, which are ordered as positive numbers are, and the face."""
    thread = cuda.grid(1)
    if thread >= len(pixels) * len(faces):
        return
    picture, face = thread // len(faces), thread % len(faces)
    height, width = kept.shape[1], kept.shape[2]
    corners = read_corners(pixels[picture], depths[picture], faces, face)
    left, right, top, bottom = find_pixels(corners, 0, height - 1, width, nearest_depth)
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            wa, wb, wc = weigh_corners(corners, np.float32(column), np.float32(row))
            near = np.float32(wa + wb + wc)
            if near > np.float32(0):
                cuda.atomic.max(kept, (picture, row, column), (np.int64(near.view(np.int32)) << 32) | np.int64(LAST_FACE - face))


@cuda.jit
def _share_corners(pixels, depths, faces, kept, shares):
    thread = cuda.grid(1)
    if thread >= kept.size:
        return
    height, width = kept.shape[1], kept.shape[2]
    picture, row, column = thread // (height * width), thread // width % height, thread % width
    noted = kept[picture, row, column]
    if noted > 0:
        corners = read_corners(pixels[picture], depths[picture], faces, LAST_FACE - (noted & LAST_FACE))
        share_pixel(corners, picture, row, column, shares)
