"""PatchMatch on a CUDA device: a thread for each pixel, of all views at once. See patchmatch.py.

The threads of one launch write only planes of one colour of the checkerboard and read only those of the other, so the result has the same
bytes every run. It differs from the CPU's by rounding, since it is calculated in single precision, in which consumer GPUs are 32 or 64
times as fast.

Without a GPU, Numba's simulator runs these kernels (NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

import numpy as np
from numba import cuda, float32

from zeroshop_steps.surface.mvs.patch_cost import COST_MAX, NEIGHBOURS, PATCH_SIDE, PLACE_WIDTH
from zeroshop_steps.surface.mvs.plane_search import initialize_plane, propagate_and_refine, recompute_cost

BLOCK = (32, 4)
"""Columns and rows of the threads of a block."""


class CudaPatchMatch:
    """See `patchmatch.PatchMatch`. Images and planes are copied to the device once, and planes back at the end."""

    def __init__(self, scene: tuple[np.ndarray, ...], near: np.ndarray, far: np.ndarray) -> None:
        rows, neighbours, color, detail, masks, sizes = scene
        self.views_at_once = len(rows)
        small = (rows.astype(np.float32), neighbours.astype(np.int32), color, detail, masks, sizes.astype(np.int32))
        depth, normal = np.zeros(near.shape, np.float32), np.zeros((*near.shape, 3), np.float32)
        cost = np.full(near.shape, COST_MAX, np.float32)
        self._scene = [cuda.to_device(array) for array in small]
        self._planes = [cuda.to_device(array) for array in (near, far, depth, normal, cost)]
        self._found = [cuda.to_device(np.zeros(shape, np.float32)) for shape in ((1, 1, 1), (1, 1, 1, 3))]
        self._shape = near.shape

    def initialize(self, views: range, seed: int) -> None:
        """See `PatchMatch`."""
        _initialize_planes[self._grid(views, 1), BLOCK](views.start, *self._scene, *self._planes, *self._found, seed)
        cuda.synchronize()

    def remember(self) -> None:
        """See `PatchMatch`."""
        _, _, depth, normal, _ = self._planes
        self._found = [cuda.device_array_like(depth), cuda.device_array_like(normal)]
        for copy, array in zip(self._found, (depth, normal), strict=True):
            copy.copy_to_device(array)

    def recompute(self, views: range) -> None:
        """See `PatchMatch`."""
        _recompute_costs[self._grid(views, 1), BLOCK](views.start, *self._scene, *self._planes, *self._found)
        cuda.synchronize()

    def refine(self, views: range, reach: float, parity: int, salt: int) -> None:
        """See `PatchMatch`."""
        _refine_planes[self._grid(views, 2), BLOCK](
            views.start, *self._scene, *self._planes, *self._found, np.float32(reach), parity, salt
        )  # fmt: skip
        cuda.synchronize()

    def read(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `PatchMatch`."""
        depth, normal, cost = (np.asarray(array.copy_to_host()) for array in self._planes[2:])
        return depth, normal, cost

    def _grid(self, views: range, step: int) -> tuple[int, int, int]:
        """Blocks that hold a thread for each `step`-th column of each row of the views."""
        _, height, width = self._shape
        return -(-width // (step * BLOCK[0])), -(-height // BLOCK[1]), len(views)


@cuda.jit
def _initialize_planes(
    first, rows, neighbours, color, detail, masks, sizes, near, far, depth, normal, cost, found_depth, found_normal, seed
):  # fmt: skip
    """`initialize_plane` at every pixel."""
    x, y, view = cuda.grid(3)
    index = first + view
    if y >= near.shape[1] or x >= near.shape[2] or far[index, y, x] <= near[index, y, x]:
        return
    space = (
        cuda.local.array((PATCH_SIDE, PATCH_SIDE), float32),
        cuda.local.array((PATCH_SIDE, PATCH_SIDE), float32),
        cuda.local.array((NEIGHBOURS, PLACE_WIDTH), float32),
    )
    planes = (near[index], far[index], depth[index], normal[index], cost[index])
    scene = (rows, neighbours, color, detail, masks, sizes)
    initialize_plane(index, scene, planes, (found_depth, found_normal), seed, y, x, space)


@cuda.jit
def _recompute_costs(first, rows, neighbours, color, detail, masks, sizes, near, far, depth, normal, cost, found_depth, found_normal):
    """`recompute_cost` at every pixel."""
    x, y, view = cuda.grid(3)
    index = first + view
    if y >= near.shape[1] or x >= near.shape[2] or far[index, y, x] <= near[index, y, x]:
        return
    space = (
        cuda.local.array((PATCH_SIDE, PATCH_SIDE), float32),
        cuda.local.array((PATCH_SIDE, PATCH_SIDE), float32),
        cuda.local.array((NEIGHBOURS, PLACE_WIDTH), float32),
    )
    planes = (near[index], far[index], depth[index], normal[index], cost[index])
    scene = (rows, neighbours, color, detail, masks, sizes)
    recompute_cost(index, scene, planes, (found_depth, found_normal), y, x, space)


@cuda.jit
def _refine_planes(
    first, rows, neighbours, color, detail, masks, sizes, near, far, depth, normal, cost, found_depth, found_normal, reach, parity, salt
):
    """`propagate_and_refine` at the pixels of one colour of the checkerboard."""
    column, y, view = cuda.grid(3)
    index, x = first + view, 2 * column + (y + parity) % 2
    if y >= near.shape[1] or x >= near.shape[2] or far[index, y, x] <= near[index, y, x]:
        return
    space = (
        cuda.local.array((PATCH_SIDE, PATCH_SIDE), float32),
        cuda.local.array((PATCH_SIDE, PATCH_SIDE), float32),
        cuda.local.array((NEIGHBOURS, PLACE_WIDTH), float32),
    )
    planes = (near[index], far[index], depth[index], normal[index], cost[index])
    scene = (rows, neighbours, color, detail, masks, sizes)
    propagate_and_refine(index, scene, planes, (found_depth, found_normal), reach, salt, y, x, space)
