"""Subdivide voxels where the images ask for finer ones, and prune those that no image needs (Sun et al. 2025, sec. 3.2)."""

import numpy as np
import torch

from zeroshop_steps.surface.svraster.octree import MAX_LEVEL
from zeroshop_steps.surface.svraster.voxels import Voxels
from zeroshop_steps.surface.training.optimizer import ResizableAdam


class VoxelMeter:
    """For each voxel, over the images since the last change: its largest blending weight, and its priority for subdivision."""

    def __init__(self, count: int, device: torch.device | None = None) -> None:
        self.weight, self.priority = torch.zeros(2, count, device=device)

    def add(self, weight: torch.Tensor, priority: torch.Tensor) -> None:
        """Count one view: (N,) largest weights and (N,) sums of |alpha d loss / d alpha|."""
        torch.maximum(self.weight, weight, out=self.weight)
        self.priority += priority


def prune_and_subdivide(
    voxels: Voxels, optimizer: ResizableAdam, keep: np.ndarray, priority: np.ndarray, max_level: int, count_max: int
) -> None:
    """Drop leaves, and split those with the highest priority into eight, which take over density, colour and the optimizer's moments.

    Args:
        keep: (N,) bool.
        priority: (N,) leaves with a larger one are split first, those of zero never.
        max_level: leaves of this level are not split.
        count_max: no more leaves than this after the change, unless more are kept.
    """
    old = voxels.octree
    wanted = keep & (priority > 0) & (old.levels < min(max_level, MAX_LEVEL))
    room = max(count_max - int(keep.sum()), 0) // 7
    if int(wanted.sum()) > room:
        urgent = np.argsort(np.where(wanted, -priority, np.inf), kind="stable")[:room]
        wanted = np.zeros(len(old), bool)
        wanted[urgent] = True
    new, source = old.refine(keep, wanted)

    def at_corners(values: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(old.interpolate(values.cpu().numpy(), new, source)).to(values.device)

    rows = torch.from_numpy(source).to(voxels.densities.device)
    optimizer.replace_tensor("densities", at_corners, at_corners)
    for name in ("sh_constant", "sh_rest"):
        optimizer.replace_tensor(name, lambda values: values[rows], lambda moment: moment[rows])
    voxels.octree = new
