"""Rasterization of a mesh on a CUDA device, a thread for each face. See rasterization_kernel.py.

A thread notes depth and face of a pixel as one number, the largest of which is kept, so the result has the same bytes every run.

Without a GPU, Numba's simulator runs these kernels (NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

import numpy as np
from numba import cuda

from zeroshop_steps.geometry.rendering.rasterization_kernel import find_pixels, read_corners, weigh_corners

THREADS = 128
"""Of a block."""
LAST_FACE = 0x7FFFFFFF
"""Faces are noted by how far they are before it, so that of two at the same depth the first is kept."""


class CudaFaces:
    """The faces of a mesh on a device, for pictures from many sides."""

    def __init__(self, faces: np.ndarray) -> None:
        self._count, self._faces = len(faces), cuda.to_device(np.ascontiguousarray(faces, np.int32))

    def draw(self, pixels: np.ndarray, depths: np.ndarray, nearest_depth: float, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """What `rasterization_kernel.draw_faces` returns, for one picture of this shape (H, W).

        Args:
            pixels: (V, 2) float32, columns and rows of the vertices.
            depths: (V,) float32.
            nearest_depth: faces with a corner no farther away are left out.
            shape: height and width of the picture.
        """
        kept = cuda.to_device(np.zeros(shape, np.int64))
        corners = (cuda.to_device(pixels), cuda.to_device(depths), self._faces)
        _keep_nearest[-(-self._count // THREADS), THREADS](*corners, np.float32(nearest_depth), kept)
        found = np.asarray(kept.copy_to_host())
        return (found >> 32).astype(np.int32).view(np.float32), np.where(found > 0, LAST_FACE - (found & LAST_FACE), -1).astype(np.int32)


@cuda.jit
def _keep_nearest(pixels, depths, faces, nearest_depth, kept):
    """Keep, for each pixel, the bits of the largest inverse depth, which are ordered as positive numbers are, and the face."""
    face = cuda.grid(1)
    if face >= len(faces):
        return
    height, width = kept.shape
    corners = read_corners(pixels, depths, faces, face)
    left, right, top, bottom = find_pixels(corners, 0, height - 1, width, nearest_depth)
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            wa, wb, wc = weigh_corners(corners, np.float32(column), np.float32(row))
            near = np.float32(wa + wb + wc)
            if near > np.float32(0):
                cuda.atomic.max(kept, (row, column), (np.int64(near.view(np.int32)) << 32) | np.int64(LAST_FACE - face))
