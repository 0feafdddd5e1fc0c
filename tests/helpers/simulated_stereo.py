"""PatchMatch on three small views of the ball with the CUDA kernels in Numba's simulator; depths, normals and costs are kept in a file.

A program of its own, as the simulator has to be chosen before Numba is imported, and compiling switched off, so that functions which the
kernels share with the CPU take the simulator's arrays: NUMBA_ENABLE_CUDASIM=1 NUMBA_DISABLE_JIT=1 python simulated_stereo.py OUT
"""

import sys

import numpy as np

from helpers.ball import ball_view
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.surface.mvs.patchmatch import estimate_depth_maps

SIZE_PX, HULL_VOXELS = 48, 24


def search(device: str, photometric_rounds: int = 1, geometric_rounds: int = 1, size_px: int = SIZE_PX) -> list[np.ndarray]:
    """Depth (3, H, W), normal (3, H, W, 3) and cost (3, H, W) of three views at the pixels of their grids."""
    views = [ball_view(azimuth, elevation, size_px, 2.0)[0] for azimuth, elevation in ((0, 10), (20, -5), (40, 15))]
    cameras, masks = [view.camera for view in views], [view.mask.numpy() > 0 for view in views]
    occupied = VisualHull.carve(cameras, masks, 1.0, HULL_VOXELS).occupied
    found = estimate_depth_maps(views, occupied, 1.0, 5, photometric_rounds, geometric_rounds, device)
    return [np.stack(part) for part in found]


if __name__ == "__main__":
    depth, normal, cost = search("cuda")
    np.savez(sys.argv[1], depth=depth, normal=normal, cost=cost)
