"""A folder of models in BOP's layout: obj_000001.ply ... in mm, and models_info.json."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from zeroshop_steps.bop.schema import read_validated
from zeroshop_steps.bop.symmetry import check_symmetries, list_symmetry_transforms
from zeroshop_steps.geometry.meshes import Mesh, read_ply
from zeroshop_steps.runtime.errors import StepError

PLAUSIBLE_DIAMETER_MM = (10.0, 3000.0)  # outside, a model is not in millimetres
SAME_DIAMETER = (0.95, 1.05)  # ratio to models_info.json; simplified meshes (models_eval) differ by less
MOST_CORNERS = 4000  # of the convex hull that are compared in pairs, 64 MB of distances


@dataclass(frozen=True)
class ObjectModel:
    """One object.

    Attributes:
        object_id: its number.
        mesh: in mm.
        diameter_mm: from models_info.json.
        symmetries: (S, 4, 4) model_from_model, the identity first.
        info: its entry of models_info.json.
    """

    object_id: int
    mesh: Mesh
    diameter_mm: float
    symmetries: np.ndarray
    info: dict


def model_path(folder: Path, object_id: int) -> Path:
    """The path of a model in BOP's layout."""
    return Path(folder) / f"obj_{object_id:06d}.ply"


def read_models_info(folder: Path) -> dict[str, dict]:
    """models_info.json of a folder of models. Raises StepError where it is missing or an entry has the wrong form."""
    return read_validated(Path(folder) / "models_info.json", "models_info")


def list_objects(folder: Path) -> list[int]:
    """The objects that have a model and an entry in models_info.json, in order."""
    listed = read_models_info(folder)
    return sorted(int(key) for key in listed if model_path(folder, int(key)).is_file())


def read_models(folder: Path, object_ids: Iterable[int]) -> dict[int, ObjectModel]:
    """Read the models of these objects.

    Raises:
        StepError: an object has no model or no entry in models_info.json, or a mesh is damaged or not in mm.
    """
    folder = Path(folder)
    listed = read_models_info(folder)
    models = {}
    for object_id in sorted(set(object_ids)):
        path = model_path(folder, object_id)
        if str(object_id) not in listed or not path.is_file():
            lacking = f"no {path.name}" if str(object_id) in listed else "no entry in models_info.json"
            raise StepError(f"object {object_id} has no model in {folder}: there is {lacking}; it has the objects {list_objects(folder)}")
        info, mesh = listed[str(object_id)], read_ply(path)
        check_diameter_mm(path, mesh, info["diameter"])
        check_symmetries(info, f"object {object_id} in {folder / 'models_info.json'}")
        models[object_id] = ObjectModel(object_id, mesh, float(info["diameter"]), list_symmetry_transforms(info), info)
    return models


def check_diameter_mm(path: Path, mesh: Mesh, listed_mm: float | None) -> float:
    """The diameter of the mesh in the file `path`.

    Args:
        path: for messages.
        mesh: its content.
        listed_mm: the diameter in models_info.json, if there is one.

    Raises:
        StepError: the mesh has another unit, or models_info.json belongs to other models.
    """
    measured_mm = measure_diameter_mm(mesh.vertices)
    smallest, largest = PLAUSIBLE_DIAMETER_MM
    if not smallest <= measured_mm <= largest:
        raise StepError(
            f"model {path} measures {measured_mm:.4g} across; expected {smallest:g} to {largest:g} mm. Convert it to millimetres."
        )
    if listed_mm is not None and not SAME_DIAMETER[0] < measured_mm / listed_mm < SAME_DIAMETER[1]:
        raise StepError(
            f"model {path} measures {measured_mm:.4g} mm across, but {path.with_name('models_info.json')} says {listed_mm:.4g};"
            " the two do not belong together"
        )
    return measured_mm


def measure_diameter_mm(vertices: np.ndarray) -> float:
    """Largest distance between two of (V, 3) vertices."""
    try:
        corners = vertices[ConvexHull(vertices).vertices]
    except QhullError:
        corners = np.unique(vertices, axis=0)
    if len(corners) > MOST_CORNERS:
        corners = corners[np.linspace(0, len(corners) - 1, MOST_CORNERS).astype(int)]
    return float(pdist(corners).max())
