"""Surfels: what 2D Gaussian Splatting trains, how it is initialized, and the file that holds it (splats.ply)."""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.geometry.meshes.ply_tables import read_ply_tables
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write
from zeroshop_steps.surface.rendering.spherical_harmonics import SH_CONSTANT
from zeroshop_steps.surface.training.initialization import Initialization

SH_COEFFICIENTS = 16
INITIAL_OPACITY = 0.1
"""As in Kerbl et al. 2023."""


def rotation_matrices(quaternions: torch.Tensor) -> torch.Tensor:
    """(N, 4) quaternions, w first, any length, to (N, 3, 3)."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=-1).unbind(-1)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return torch.stack(rows, -1).reshape(-1, 3, 3)


@dataclass
class Surfels:
    """N surfels; the arguments of `render.render`, in normalized coordinates.

    Attributes:
        positions: (N, 3). log_scales: (N, 2). quaternions: (N, 4), w first. opacity_logits: (N,).
        sh_constant: (N, 1, 3) and sh_rest: (N, 15, 3), apart because they learn at different rates.
    """

    positions: torch.Tensor
    log_scales: torch.Tensor
    quaternions: torch.Tensor
    opacity_logits: torch.Tensor
    sh_constant: torch.Tensor
    sh_rest: torch.Tensor

    def __len__(self) -> int:
        return len(self.positions)

    def tensors(self) -> dict[str, torch.Tensor]:
        """All of them by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def initialize_surfels(initialization: Initialization, seed: int) -> Surfels:
    """One surfel at each initial point, with its colour and normal, as wide as the distance to its neighbours."""
    points, colors, normals, opacity = initialization.points, initialization.colors, initialization.normals, INITIAL_OPACITY
    if len(points) < 4:
        raise StepError(
            f"{len(points)} starting points lie inside the masks; at least 4 are needed. Check that masks and images belong"
            " together, or start from stereo (--initialization stereo)"
        )
    distances, _ = cKDTree(points).query(points, k=4)
    spread = np.clip(np.sqrt((distances[:, 1:] ** 2).mean(1)), 1e-4, 0.1)
    # Turned at random about the normal, so that no common direction of the surfels' axes biases the result.
    half_turns = np.random.default_rng(seed).uniform(0, np.pi, len(points))
    turns = Rotation.from_quat(quaternions_towards(normals), scalar_first=True) * Rotation.from_rotvec(2 * half_turns[:, None] * [0, 0, 1])
    quaternions = turns.as_quat(scalar_first=True)
    return Surfels(
        torch.tensor(points, dtype=torch.float32),
        torch.tensor(np.log(spread), dtype=torch.float32)[:, None].repeat(1, 2),
        torch.tensor(quaternions, dtype=torch.float32),
        torch.full((len(points),), float(np.log(opacity / (1 - opacity)))),
        torch.tensor((colors - 0.5) / SH_CONSTANT, dtype=torch.float32)[:, None, :],
        torch.zeros(len(points), SH_COEFFICIENTS - 1, 3),
    )


def quaternions_towards(normals: np.ndarray) -> np.ndarray:
    """(N, 4) unit quaternions, w first, that turn the z axis to (N, 3) unit normals."""
    w = 1.0 + normals[:, 2]
    quaternions = np.stack([w, -normals[:, 1], normals[:, 0], np.zeros(len(normals))], 1)
    quaternions[w < 1e-6] = [0.0, 1.0, 0.0, 0.0]
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def _ply_columns() -> list[str]:
    columns = ["x", "y", "z", "nx", "ny", "nz"] + [f"f_dc_{i}" for i in range(3)]
    columns += [f"f_rest_{i}" for i in range(3 * (SH_COEFFICIENTS - 1))]
    return columns + ["opacity", "scale_0", "scale_1", "scale_2"] + [f"rot_{i}" for i in range(4)]


FLAT_LOG_SCALE = -14.0
"""Third scale in the PLY, relative to the scene: common viewers draw 3D Gaussians, and a surfel is a flat one."""


def write_splat_ply(path: Path, surfels: Surfels, sphere: ObjectSphere) -> None:
    """Write the splat PLY that common 3D Gaussian viewers open, in world coordinates.

    The layout is that of Kerbl et al. 2023: float columns, spherical harmonics channel by channel, scales as logarithms, opacity as
    logit, quaternion w first. The third scale is next to nothing, since these Gaussians are flat.
    """
    count = len(surfels)
    tensors = {name: tensor.detach().cpu().numpy() for name, tensor in surfels.tensors().items()}
    normals = rotation_matrices(surfels.quaternions.detach().cpu())[:, :, 2].numpy()
    columns = np.concatenate(
        [
            tensors["positions"] * sphere.radius + sphere.centre,
            normals,
            tensors["sh_constant"].reshape(count, 3),
            tensors["sh_rest"].transpose(0, 2, 1).reshape(count, -1),
            tensors["opacity_logits"][:, None],
            tensors["log_scales"] + np.log(sphere.radius),
            np.full((count, 1), FLAT_LOG_SCALE + np.log(sphere.radius)),
            tensors["quaternions"],
        ],
        axis=1,
    ).astype("<f4")
    centre = " ".join(repr(float(value)) for value in sphere.centre)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment object_sphere {centre} {float(sphere.radius)!r}",
        f"element vertex {count}",
    ]
    header += [f"property float {name}" for name in _ply_columns()] + ["end_header", ""]
    with atomic_write(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + columns.tobytes())


def read_splat_ply(path: Path) -> tuple[Surfels, ObjectSphere]:
    """Read what `write_splat_ply` wrote. Raises StepError when the file is something else."""
    path = Path(path)
    if not path.is_file():
        raise StepError(f"{path} does not exist; train first")
    try:
        tables = read_ply_tables(path)
    except StepError as error:
        raise StepError(f"{path} is not a whole splat PLY of this project; delete it and train again ({error})") from error
    vertex = tables.elements.get("vertex")
    sphere_line = [remark.split()[1:] for remark in tables.remarks if remark.startswith("object_sphere")]
    if vertex is None or list(vertex.columns) != _ply_columns() or not sphere_line:
        raise StepError(f"{path} is not a splat PLY of this project; delete it and train again")
    values = np.stack(list(vertex.columns.values()), 1).astype(np.float32)
    *centre, radius = (float(value) for value in sphere_line[0])
    sphere = ObjectSphere(np.array(centre), radius)
    rest = values[:, 9 : 9 + 45].reshape(-1, 3, SH_COEFFICIENTS - 1).transpose(0, 2, 1)
    columns = (
        (values[:, :3] - sphere.centre) / radius,
        values[:, 55:57] - np.log(radius),
        values[:, 58:62],
        values[:, 54],
        values[:, None, 6:9],
        rest,
    )
    return Surfels(*(torch.from_numpy(np.ascontiguousarray(column, dtype=np.float32)) for column in columns)), sphere
