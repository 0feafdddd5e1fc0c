"""How both renderers' CPU kernels cut an image: tiles of 16 x 16 pixels in blocks of 4 x 4, which are drawn at once.

The loop over the pixels of a block becomes vector instructions. The planes of a block (transmittance, colour and so on) lie
one behind the other in one buffer.
"""

import numpy as np

from zeroshop_steps.surface.training_views import TILE_PX

BLOCK_PX = 4
"""Width and height of a block: as many pixels as fit into one 512-bit register in single precision."""
ACROSS = TILE_PX // BLOCK_PX
BLOCKS = ACROSS * ACROSS
LANES = BLOCK_PX * BLOCK_PX
"""Pixels of a block."""
PLANE = tuple(np.uint64(plane * LANES) for plane in range(30))
"""Where each plane of a block begins. Unsigned, since a signed index might be a negative one that counts from the end, and the
compiler then gives up on vector instructions."""
BIT = np.array([0, 0, 1, 13, 2, 0, 14, 6, 3, 8, 0, 12, 15, 5, 7, 11, 4, 10, 9], np.uint64)
"""The number of a single bit, at the remainder of its value by 19: two is a primitive root of 19."""
STOP = np.float32(1e-4)
"""Transmittance below which a pixel is finished."""
ONE, HALF, TWO, ZERO = np.float32(1.0), np.float32(0.5), np.float32(2.0), np.float32(0.0)
