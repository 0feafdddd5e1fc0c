"""The true object: what the camera sees, what physics moves, and what poses and masks are measured against."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.symmetry import list_symmetry_transforms
from zeroshop_steps.bop.scoring.pose_error import ModelPoints, mssd
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.surface_parts import with_texture
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.simulate.dynamics.physical_body import PhysicalBody, read_body

SEGMENTED_IOU = 0.5
"""Of a mask with the true visible one, from which the object counts as segmented."""


@dataclass(frozen=True)
class TrueObject:
    """One object.

    Attributes:
        object_id: its number in folders of models.
        mesh: textured, mm.
        diameter_mm: BOP's.
        symmetries: (S, 4, 4) of the mesh, mm.
        body: what physics moves.
        truth_from_mesh: (4, 4) similarity, mm: from the mesh that the robot knows to this one; the identity for a true one.
    """

    object_id: int
    mesh: Mesh
    diameter_mm: float
    symmetries: np.ndarray
    body: PhysicalBody
    truth_from_mesh: np.ndarray

    def pose_error_mm(self, camera_from_mesh: np.ndarray, camera_from_model: np.ndarray) -> float:
        """MSSD of an estimated pose (4, 4) of the robot's mesh, applied to the true model whose (4, 4) pose is known; mm."""
        return pose_error_mm(camera_from_mesh, self.truth_from_mesh, camera_from_model, self.mesh.vertices, self.symmetries)


def read_true_object(model: Path, body: Path, aligned: Path | None) -> TrueObject:
    """Read the folder of a model, its body, and the alignment of the robot's mesh with it, if that is not the model itself.

    Raises:
        StepError: a file is missing or damaged.
    """
    mesh, info = with_texture(read_ply(model / "model.ply")), read_json(model / "model_info.json")
    transform = np.eye(4) if aligned is None else np.array(read_json(aligned)["truth_from_mesh"], float)
    return TrueObject(int(info["obj_id"]), mesh, float(info["diameter"]), list_symmetry_transforms(info), read_body(body), transform)


def in_mm(transform: np.ndarray) -> np.ndarray:
    """A (4, 4) rigid transform of metres as one of millimetres."""
    scaled = transform.copy()
    scaled[:3, 3] *= MM_PER_M
    return scaled


def in_metres(transform: np.ndarray) -> np.ndarray:
    """A (4, 4) rigid transform of millimetres as one of metres."""
    scaled = transform.copy()
    scaled[:3, 3] /= MM_PER_M
    return scaled


def pose_error_mm(
    camera_from_mesh: np.ndarray, truth_from_mesh: np.ndarray, camera_from_model: np.ndarray, vertices: np.ndarray, symmetries: np.ndarray
) -> float:
    """MSSD of a pose of the robot's mesh, applied to the true model; mm.

    Args:
        camera_from_mesh: (4, 4) the estimate.
        truth_from_mesh: (4, 4) similarity from the robot's mesh to the true model.
        camera_from_model: (4, 4) the true pose of the true model.
        vertices: (V, 3) of the true model.
        symmetries: (S, 4, 4) of the true model.
    """
    estimated = camera_from_mesh @ np.linalg.inv(truth_from_mesh)
    return float(mssd(estimated[None], camera_from_model[None], ModelPoints.from_vertices(vertices), symmetries)[0])
