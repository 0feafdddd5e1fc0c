"""Voxels: what the training of sparse voxels trains, and the file that holds it (voxels.npz)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write
from zeroshop_steps.surface.svraster.octree import Octree

FIELDS = ("origins", "levels", "densities", "sh", "centre", "radius")


@dataclass
class Voxels:
    """Leaves of an octree and what they hold; the arguments of `render.render`.

    Attributes:
        octree: N leaves with M corners.
        densities: (M,) value before activation at each corner.
        sh_constant: (N, 1, 3) and sh_rest: (N, K - 1, 3), apart because they learn at different rates.
    """

    octree: Octree
    densities: torch.Tensor
    sh_constant: torch.Tensor
    sh_rest: torch.Tensor

    def __len__(self) -> int:
        return len(self.octree)

    def tensors(self) -> dict[str, torch.Tensor]:
        """What is trained, by name."""
        return {"densities": self.densities, "sh_constant": self.sh_constant, "sh_rest": self.sh_rest}


def write_voxels(path: Path, voxels: Voxels, sphere: ObjectSphere) -> None:
    """Write a compressed NumPy archive: leaves, values at the corners (in the order of `Octree.corner_points`), colours, sphere."""
    sh = torch.cat([voxels.sh_constant, voxels.sh_rest], 1).detach().cpu().numpy()
    octree = voxels.octree
    arrays = (octree.origins.astype(np.int16), octree.levels.astype(np.int8), voxels.densities.detach().cpu().numpy(), sh)
    content: dict[str, Any] = dict(zip(FIELDS, (*arrays, sphere.centre, np.array(sphere.radius)), strict=True))
    with atomic_write(path) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **content)


def read_voxels(path: Path) -> tuple[Voxels, ObjectSphere]:
    """Read what `write_voxels` wrote. Raises StepError when the file is something else."""
    path = Path(path)
    if not path.is_file():
        raise StepError(f"{path} does not exist; train first")
    try:
        with np.load(path, allow_pickle=False) as archive:
            origins, levels, densities, sh, centre, radius = (archive[name] for name in FIELDS)
        octree = Octree(origins.astype(np.int64), levels.astype(np.int64))
        whole = densities.shape == (octree.corner_count,) and sh.shape[::2] == (len(octree), 3)
    except Exception as error:
        raise StepError(f"{path} is not a whole voxel file ({type(error).__name__}); delete it and train again") from None
    if not whole:
        raise StepError(f"{path} is not a whole voxel file: corners and leaves do not fit; delete it and train again")
    parts = (torch.from_numpy(np.ascontiguousarray(part)) for part in (densities, sh[:, :1], sh[:, 1:]))
    return Voxels(octree, *parts), ObjectSphere(centre, float(radius))
