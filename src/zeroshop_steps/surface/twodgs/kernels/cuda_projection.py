"""The projection of 2D Gaussian Splatting for CUDA, forward and backward, a thread for each surfel.

What a thread does is the same function as on the CPU, in double precision: a few hundred operations a surfel. Without a GPU, Numba's
simulator runs these kernels (NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

from numba import cuda, float32, float64

from zeroshop_steps.surface.rendering.tiling import TILE_PX, ZERO, tiles_of
from zeroshop_steps.surface.twodgs.kernels.layout import SPLAT_WIDTH
from zeroshop_steps.surface.twodgs.kernels.project import differentiate_surfel, project_surfel
from zeroshop_steps.surface.twodgs.kernels.tiles import mark_splat


@cuda.jit
def project(
    positions, log_scales, quaternions, opacity_logits, sh, degree, camera, width_px, height_px, near, count, splats, outlines, boxes, slots
):
    """Fill splats, outlines and boxes as `project.project_forward`, and slots (N,) int32: how many tiles the box of each surfel meets."""
    i = cuda.grid(1)
    if i < count:
        p, basis = cuda.local.array(3, float64), cuda.local.array(16, float64)
        rotation, tangents = cuda.local.array((3, 3), float64), cuda.local.array((3, 3), float64)
        project_surfel(
            positions, log_scales, quaternions, opacity_logits, sh, i, degree, camera, width_px, height_px, near,
            p, rotation, tangents, basis, splats, outlines, boxes,
        )  # fmt: skip
        left, right, top, bottom = tiles_of(boxes, i)
        slots[i] = (right - left) * (bottom - top)


@cuda.jit
def mark_blocks(splats, outlines, boxes, tile_active, slot_starts, tiles_x, count, blocks, tile_of, splat_of):
    """Fill, for each slot, blocks (S,) int32, which must hold zeros, as `tiles.TileLists` has them, and its tile and splat, (S,) int32."""
    i = cuda.grid(1)
    if i < count:
        left, right, top, bottom = tiles_of(boxes, i)
        slot = slot_starts[i]
        for ty in range(top, bottom):
            for tx in range(left, right):
                tile_of[slot], splat_of[slot] = ty * tiles_x + tx, i
                slot += 1
        mark_splat(splats, outlines, boxes, tile_active, slot_starts, i, float32(tiles_x * TILE_PX), blocks)


@cuda.jit
def sum_slots(slots, slot_starts, count, out):
    """Sum the rows (S, 16) of each splat into out (N, 16), in order: a thread for each number."""
    splat, column = cuda.grid(2)
    if splat < count and column < SPLAT_WIDTH:
        total = ZERO
        for slot in range(slot_starts[splat], slot_starts[splat + 1]):
            total += slots[slot, column]
        out[splat, column] = total


@cuda.jit
def differentiate(
    positions, log_scales, quaternions, sh, degree, camera, count, splats, boxes, splat_gradients,
    position_gradients, log_scale_gradients, quaternion_gradients, opacity_gradients, sh_gradients,
):  # fmt: skip
    """Fill the gradients by the surfels' parameters, which must hold zeros, as `project.project_backward`."""
    i = cuda.grid(1)
    if i < count:
        p, gp, basis, slopes = (
            cuda.local.array(3, float64),
            cuda.local.array(3, float64),
            cuda.local.array(16, float64),
            cuda.local.array((16, 3), float64),
        )
        rotation, tangents = cuda.local.array((3, 3), float64), cuda.local.array((3, 3), float64)
        gt, grotation = cuda.local.array((3, 3), float64), cuda.local.array((3, 3), float64)
        differentiate_surfel(
            positions, log_scales, quaternions, sh, i, degree, camera, splats, boxes, splat_gradients,
            p, rotation, tangents, basis, slopes, gp, gt, grotation,
            position_gradients, log_scale_gradients, quaternion_gradients, opacity_gradients, sh_gradients,
        )  # fmt: skip
