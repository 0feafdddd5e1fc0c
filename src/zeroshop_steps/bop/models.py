"""A folder of models in BOP's layout: obj_000001.ply ... in mm, and models_info.json."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.schema import read_checked
from zeroshop_steps.bop.symmetry import symmetry_transforms
from zeroshop_steps.capture.bop_models import checked_diameter_mm
from zeroshop_steps.errors import StepError
from zeroshop_steps.meshes import Mesh, read_ply


@dataclass(frozen=True)
class Model:
    """One object.

    Attributes:
        object_id: its number.
        mesh: in mm.
        diameter_mm: as models_info.json says.
        symmetries: (S, 4, 4) model_from_model, the identity first.
        info: its entry of models_info.json.
    """

    object_id: int
    mesh: Mesh
    diameter_mm: float
    symmetries: np.ndarray
    info: dict


def model_file(folder: Path, object_id: int) -> Path:
    """Where BOP keeps a model."""
    return Path(folder) / f"obj_{object_id:06d}.ply"


def listed_objects(folder: Path) -> list[int]:
    """The objects that have a model and an entry in models_info.json."""
    listed = read_checked(Path(folder) / "models_info.json", "models_info")
    return sorted(int(key) for key in listed if model_file(folder, int(key)).is_file())


def read_models(folder: Path, object_ids: Iterable[int]) -> dict[int, Model]:
    """Read the models of these objects.

    Raises:
        StepError: an object has no model or no entry in models_info.json, a mesh is damaged or not in mm.
    """
    folder = Path(folder)
    listed = read_checked(folder / "models_info.json", "models_info")
    models = {}
    for object_id in sorted(set(object_ids)):
        path = model_file(folder, object_id)
        if str(object_id) not in listed or not path.is_file():
            lacking = f"no {path.name}" if str(object_id) in listed else "no entry in models_info.json"
            raise StepError(f"object {object_id} has no model in {folder}: there is {lacking}; it has the objects {listed_objects(folder)}")
        info, mesh = listed[str(object_id)], read_ply(path)
        checked_diameter_mm(path, mesh, info["diameter"])
        models[object_id] = Model(object_id, mesh, float(info["diameter"]), symmetry_transforms(info), info)
    return models
