"""How both renderers' CPU kernels divide an image: into tiles of 16 x 16 pixels, and tiles into blocks of 4 x 4.

A thread draws a tile. A block is drawn at once: the loop over its pixels becomes vector instructions, so its pixels are also
called lanes. The values of a block (transmittance, colour and so on) lie as planes one behind the other in one buffer, so
that the compiler can prove that loads and stores do not overlap.
"""

import numba
import numpy as np

TILE_PX = 16
"""Width and height of a tile: a row of it fills one 512-bit register in single precision."""
BLOCK_PX = 4
"""Width and height of a block: as many pixels as fit into one 512-bit register in single precision."""
ACROSS = TILE_PX // BLOCK_PX
"""Blocks along an edge of a tile."""
BLOCKS = ACROSS * ACROSS
"""Blocks of a tile. Sets of them are bit masks: bit 4 y + x."""
LANES = BLOCK_PX * BLOCK_PX
"""Pixels of a block."""
PLANE = tuple(np.uint64(plane * LANES) for plane in range(30))
"""Where each plane of a block begins. Unsigned: a signed index might be negative and count from the end, and the compiler then
gives up on vector instructions."""
BIT = np.array([0, 0, 1, 13, 2, 0, 14, 6, 3, 8, 0, 12, 15, 5, 7, 11, 4, 10, 9], np.uint64)
"""The number of a single bit, at the remainder of its value by 19: two is a primitive root of 19, so the remainders differ."""
STOP = np.float32(1e-4)
"""Transmittance below which a pixel is finished (Kerbl et al. 2023)."""
ONE, HALF, TWO, ZERO = np.float32(1.0), np.float32(0.5), np.float32(2.0), np.float32(0.0)
"""In single precision, since a literal would make the kernels compute in double precision."""


def find_active_tiles(active: np.ndarray) -> np.ndarray:
    """(ceil(H / 16), ceil(W / 16)) bool: the tiles of an (H, W) bool array that hold any True."""
    height, width = active.shape
    padded = np.zeros((-(-height // TILE_PX) * TILE_PX, -(-width // TILE_PX) * TILE_PX), bool)
    padded[:height, :width] = active
    return np.asarray(padded.reshape(padded.shape[0] // TILE_PX, TILE_PX, padded.shape[1] // TILE_PX, TILE_PX).any(axis=(1, 3)))


@numba.njit(cache=True, forceinline=True)
def tiles_of(boxes, i):
    """First and last column and row, half open, of the tiles that row i of boxes (N, 4), x0, x1, y0, y1 in pixels, meets."""
    if boxes[i, 0] >= boxes[i, 1] or boxes[i, 2] >= boxes[i, 3]:
        return 0, 0, 0, 0
    return boxes[i, 0] // TILE_PX, (boxes[i, 1] - 1) // TILE_PX + 1, boxes[i, 2] // TILE_PX, (boxes[i, 3] - 1) // TILE_PX + 1
