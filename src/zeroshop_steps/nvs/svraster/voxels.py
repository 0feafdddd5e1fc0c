"""The trained quantities of sparse voxels, where they start, and the file they are kept in."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from zeroshop_steps.cameras import Camera
from zeroshop_steps.errors import StepError
from zeroshop_steps.files import written_whole
from zeroshop_steps.nvs.harmonics import SH_CONSTANT
from zeroshop_steps.nvs.hull import VisualHull
from zeroshop_steps.nvs.svraster.octree import CELLS, CORNER_OFFSETS, Octree
from zeroshop_steps.nvs.views import ObjectSphere

MIST_DENSITY, SURFACE_DENSITY = -2.0, 0.0
"""Values before activation at the start: a leaf of level 6 has the opacity 0.2 or, near points of the surface, 0.7."""
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


def start_octree(cameras: list[Camera], masks: list[np.ndarray], holds_nothing, level: int) -> Octree:
    """The cells of a level that the visual hull meets and that are not wholly in free space.

    Args:
        cameras, masks: views in normalized coordinates and their (H, W) bool masks.
        holds_nothing: tells for (P, 3) points which lie in free space, outside the masks too, as (P,) bool.
    """
    coarse = VisualHull.carve(cameras, masks, half_extent=1.0, resolution=1 << level, misses_allowed=1).occupied
    cells = np.argwhere(binary_dilation(coarse, np.ones((3, 3, 3), bool)))
    children = ((2 * cells[:, None] + CORNER_OFFSETS + 0.5) / (1 << level) - 1.0).reshape(-1, 3)
    solid = ~holds_nothing(children).reshape(-1, 8).all(axis=1)
    return Octree.of(cells[solid] * (CELLS >> level), np.full(int(solid.sum()), level))


def start_voxels(octree: Octree, points: np.ndarray, colors: np.ndarray, sh_degree: int) -> Voxels:
    """Thin mist, denser near (P, 3) points where a surface is known to be; each leaf's (N, 3) RGB colour from all sides."""
    corners = octree.corner_points * (2.0 / CELLS) - 1.0
    known = (
        cKDTree(points).query(corners, distance_upper_bound=octree.sizes.max())[0] < np.inf if len(points) else np.zeros(len(corners), bool)
    )
    return Voxels(
        octree,
        torch.from_numpy(np.where(known, SURFACE_DENSITY, MIST_DENSITY).astype(np.float32)),
        torch.tensor((colors - 0.5) / SH_CONSTANT, dtype=torch.float32)[:, None, :],
        torch.zeros(len(octree), (sh_degree + 1) ** 2 - 1, 3),
    )


def write_voxels(path: Path, voxels: Voxels, sphere: ObjectSphere) -> None:
    """Write a compressed NumPy archive: leaves, values at the corners (in the order of `Octree.corner_points`), colours, sphere."""
    sh = torch.cat([voxels.sh_constant, voxels.sh_rest], 1).detach().numpy()
    arrays = (voxels.octree.origins.astype(np.int16), voxels.octree.levels.astype(np.int8), voxels.densities.detach().numpy(), sh)
    with written_whole(path) as temporary:
        np.savez_compressed(temporary, **dict(zip(FIELDS, (*arrays, sphere.centre, sphere.radius), strict=True)))


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
