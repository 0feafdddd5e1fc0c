"""The projection of sparse voxels for CUDA, forward and backward, a thread for each voxel.

What a thread does is the same function as on the CPU, in double precision. Without a GPU, Numba's simulator runs these kernels
(NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

from numba import cuda, float64

from zeroshop_steps.surface.rendering.tiling import ZERO, tiles_of
from zeroshop_steps.surface.svraster.kernels.layout import G_WEIGHT, GRADIENT_WIDTH
from zeroshop_steps.surface.svraster.kernels.project import differentiate_voxel, project_voxel, sum_uses
from zeroshop_steps.surface.svraster.octree import OCTANTS


@cuda.jit
def project(
    centres, sizes, corners, densities, sh, degree, camera, width_px, height_px, near, index, count, rows, boxes, slots
):  # fmt: skip
    """Fill rows and boxes as `project.project_forward`, and slots (N,) int32: how many pairs of tile and octant each voxel's box meets."""
    i = cuda.grid(1)
    if i < count:
        c, basis = cuda.local.array(3, float64), cuda.local.array(16, float64)
        v, p = cuda.local.array(8, float64), cuda.local.array(8, float64)
        project_voxel(
            centres, sizes, corners, densities, sh, i, degree, camera, width_px, height_px, near, c, v, p, basis, rows, boxes
        )  # fmt: skip
        left, right, top, bottom = tiles_of(boxes, i)
        met = 0
        for ty in range(top, bottom):
            for tx in range(left, right):
                for octant in range(OCTANTS):
                    if index[ty, tx, octant] >= 0:
                        met += 1
        slots[i] = met


@cuda.jit
def list_pairs(boxes, index, slot_starts, count, pair_of, voxel_of):
    """Fill the pair and the voxel of each slot, (E,) int32."""
    i = cuda.grid(1)
    if i < count:
        left, right, top, bottom = tiles_of(boxes, i)
        slot = slot_starts[i]
        for ty in range(top, bottom):
            for tx in range(left, right):
                for octant in range(OCTANTS):
                    if index[ty, tx, octant] >= 0:
                        pair_of[slot], voxel_of[slot] = index[ty, tx, octant], i
                        slot += 1


@cuda.jit
def sum_slots(slots, slot_starts, count, out):
    """Gather the rows (E, 16) of each voxel in out (N, 16), in order: a thread for each number."""
    voxel, column = cuda.grid(2)
    if voxel < count and column < GRADIENT_WIDTH:
        total = ZERO
        for slot in range(slot_starts[voxel], slot_starts[voxel + 1]):
            total = max(total, slots[slot, column]) if column == G_WEIGHT else total + slots[slot, column]
        out[voxel, column] = total


@cuda.jit
def differentiate(centres, degree, camera, count, rows, boxes, gradients, corner_gradients, sh_gradients):
    """Fill the gradients by corner values (N, 8) and sh (N, K, 3), which must hold zeros, as `project.project_backward`."""
    i = cuda.grid(1)
    if i < count and boxes[i, 0] < boxes[i, 1]:
        g, out, basis = cuda.local.array(8, float64), cuda.local.array(8, float64), cuda.local.array(16, float64)
        differentiate_voxel(centres, i, degree, camera, rows, gradients, g, out, basis, corner_gradients, sh_gradients)


@cuda.jit
def gather_corners(starts, uses, corner_gradients, count, out):
    """As `project.gather_corners`: a thread for each corner."""
    corner = cuda.grid(1)
    if corner < count:
        out[corner] = sum_uses(starts, uses, corner_gradients, corner)
