"""PatchMatch on the processor's cores, which share the rows of a view. See patchmatch.py.

Numba infers the types of a parallel loop twice, with a signed and with an unsigned row. What is called gets a signed one: it is compiled
once.
"""

import numba
import numpy as np

from zeroshop_steps.surface.mvs.patch_cost import COST_MAX, PATCH_SIDE, PLACE_WIDTH
from zeroshop_steps.surface.mvs.plane_search import initialize_plane, propagate_and_refine, recompute_cost


class CpuPatchMatch:
    """See `patchmatch.PatchMatch`. Of one view after the other, since its images stay in the cache."""

    views_at_once = 1

    def __init__(self, scene: tuple[np.ndarray, ...], near: np.ndarray, far: np.ndarray) -> None:
        self._scene, self._near, self._far = scene, near, far
        self.depth, self.normal = np.zeros(near.shape, np.float32), np.zeros((*near.shape, 3), np.float32)
        self.cost = np.full(near.shape, COST_MAX, np.float32)
        self._found: tuple[np.ndarray, ...] = (np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 1, 3), np.float32))

    def initialize(self, views: range, seed: int) -> None:
        """See `PatchMatch`."""
        for i in views:
            _initialize_planes(i, self._scene, self._planes(i), self._found, seed)

    def remember(self) -> None:
        """See `PatchMatch`."""
        self._found = (self.depth.copy(), self.normal.copy())

    def recompute(self, views: range) -> None:
        """See `PatchMatch`."""
        for i in views:
            _recompute_costs(i, self._scene, self._planes(i), self._found)

    def refine(self, views: range, reach: float, parity: int, salt: int) -> None:
        """See `PatchMatch`."""
        for i in views:
            _refine_planes(i, self._scene, self._planes(i), self._found, reach, parity, salt)

    def read(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `PatchMatch`."""
        return self.depth, self.normal, self.cost

    def _planes(self, i: int) -> tuple[np.ndarray, ...]:
        return self._near[i], self._far[i], self.depth[i], self.normal[i], self.cost[i]


@numba.njit(cache=True, parallel=True)
def _initialize_planes(index, scene, planes, found, seed):
    """`initialize_plane` at every pixel of a view's grid."""
    near, far = planes[0], planes[1]
    count = scene[1].shape[1]
    for y in numba.prange(near.shape[0]):
        patch, weight = np.empty((PATCH_SIDE, PATCH_SIDE), np.float32), np.empty((PATCH_SIDE, PATCH_SIDE), np.float32)
        space = (patch, weight, np.empty((count, PLACE_WIDTH)))
        for x in range(near.shape[1]):
            if far[y, x] > near[y, x]:
                initialize_plane(index, scene, planes, found, seed, np.int64(y), x, space)


@numba.njit(cache=True, parallel=True)
def _recompute_costs(index, scene, planes, found):
    """`recompute_cost` at every pixel of a view's grid."""
    near, far = planes[0], planes[1]
    count = scene[1].shape[1]
    for y in numba.prange(near.shape[0]):
        patch, weight = np.empty((PATCH_SIDE, PATCH_SIDE), np.float32), np.empty((PATCH_SIDE, PATCH_SIDE), np.float32)
        space = (patch, weight, np.empty((count, PLACE_WIDTH)))
        for x in range(near.shape[1]):
            if far[y, x] > near[y, x]:
                recompute_cost(index, scene, planes, found, np.int64(y), x, space)


@numba.njit(cache=True, parallel=True)
def _refine_planes(index, scene, planes, found, reach, parity, salt):
    """`propagate_and_refine` at the pixels of one colour of the checkerboard."""
    near, far = planes[0], planes[1]
    count = scene[1].shape[1]
    for y in numba.prange(near.shape[0]):
        patch, weight = np.empty((PATCH_SIDE, PATCH_SIDE), np.float32), np.empty((PATCH_SIDE, PATCH_SIDE), np.float32)
        space = (patch, weight, np.empty((count, PLACE_WIDTH)))
        for x in range((y + parity) % 2, near.shape[1], 2):
            if far[y, x] > near[y, x]:
                propagate_and_refine(index, scene, planes, found, reach, salt, np.int64(y), x, space)
