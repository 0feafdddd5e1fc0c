"""A folder of models in BOP's layout: obj_000001.ply ... in mm, and models_info.json; without that file, it is computed."""

import functools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from zeroshop_steps.bop.formats.schema import read_validated
from zeroshop_steps.bop.formats.symmetry import check_symmetries, list_symmetry_transforms
from zeroshop_steps.geometry.meshes.mesh_files import SUFFIXES, find_mesh, read_mesh
from zeroshop_steps.geometry.meshes.triangle_meshes import OBJECT_SIZES_M, Mesh, diameter_of
from zeroshop_steps.runtime.errors import StepError, warn

SAME_DIAMETER = (0.95, 1.05)  # ratio to models_info.json; simplified meshes (models_eval) differ by less
SAME_DIAGONAL = (0.99, 1.01)  # the same of the diagonal of the bounding box
MOST_CORNERS = 4000  # of the convex hull that are compared in pairs, 64 MB of distances


@dataclass(frozen=True)
class ObjectModel:
    """One object.

    Attributes:
        object_id: its number.
        mesh: in mm.
        diameter_mm: from models_info.json; of the mesh, where that lists another length or none.
        symmetries: (S, 4, 4) model_from_model, the identity first.
        info: its entry of models_info.json.
    """

    object_id: int
    mesh: Mesh
    diameter_mm: float
    symmetries: np.ndarray
    info: dict

    @property
    def scored_diameter_mm(self) -> float:
        """The listed diameter, by which BOP's scores divide whatever it is."""
        return float(self.info.get("diameter", self.diameter_mm))


def model_path(folder: Path, object_id: int) -> Path:
    """The path of a model in BOP's layout: its file, or where it has none, that of its PLY."""
    stem = Path(folder) / f"obj_{object_id:06d}"
    return find_mesh(stem) or stem.with_suffix(".ply")


def read_models_info(folder: Path) -> dict[str, dict]:
    """models_info.json of a folder of models; where there is none, it is computed from the models, without symmetries.

    Raises:
        StepError: there are no models either, or an entry has the wrong form.
    """
    path = Path(folder) / "models_info.json"
    files = [] if path.is_file() else list_model_files(folder)
    if files:
        return _describe_files(path, tuple((file, file.stat().st_mtime_ns) for file in files))
    return read_validated(path, "models_info")


def list_model_files(folder: Path) -> list[Path]:
    """The files obj_000001.ply and so on of a folder, one for each object, in order."""
    found = Path(folder).glob("obj_*") if Path(folder).is_dir() else []
    numbers = {int(file.stem[4:]) for file in found if file.suffix.lower() in SUFFIXES and re.fullmatch(r"obj_\d{6}", file.stem)}
    return [model_path(folder, number) for number in sorted(numbers)]


def describe_model(path: Path, mesh: Mesh, listed_mm: float | None = None) -> dict[str, float]:
    """Diameter, min_x to size_z of a mesh, in mm, for models_info.json; the arguments are those of `check_diameter_mm`."""
    low, size = mesh.vertices.min(0), np.ptp(mesh.vertices, axis=0)
    found = {"diameter": check_diameter_mm(path, mesh, listed_mm)}
    found |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    return found | {f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}


@functools.lru_cache(maxsize=8)
def _describe_files(path: Path, files: tuple[tuple[Path, int], ...]) -> dict[str, dict]:
    """models_info.json of these files, which were last changed at these times."""
    warn(
        f"{path} does not exist: diameters are computed, and no object counts as symmetric. Write the file, with symmetries of the shape,"
        " by python -m zeroshop_steps.bop --method models_info --symmetries --models FOLDER"
    )
    return {str(int(file.stem[4:])): describe_model(file, read_mesh(file)) for file, _ in files}


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
        info, mesh = listed[str(object_id)], read_mesh(path)
        diameter_mm = check_diameter_mm(path, mesh, info.get("diameter"))
        check_symmetries(info, f"object {object_id} in {folder / 'models_info.json'}")
        models[object_id] = ObjectModel(object_id, mesh, diameter_mm, list_symmetry_transforms(info), info)
    return models


def check_diameter_mm(path: Path, mesh: Mesh, listed_mm: float | None) -> float:
    """The diameter of the mesh in the file `path`: the listed one, if that is the mesh's, else as measured.

    Some published datasets, such as TYO-L, list the diagonal of the bounding box. That is taken with a note.

    Args:
        path: for messages.
        mesh: its content.
        listed_mm: the diameter in models_info.json, if there is one.

    Raises:
        StepError: the mesh has another unit, or models_info.json belongs to other models.
    """
    measured_mm = measure_diameter_mm(mesh.vertices)
    smallest, largest = (1000 * size_m for size_m in OBJECT_SIZES_M)
    if not smallest <= measured_mm <= largest:
        raise StepError(
            f"model {path} measures {measured_mm:.4g} across; expected {smallest:g} to {largest:g} mm. Convert it to millimetres."
        )
    if listed_mm is None:
        return measured_mm
    if SAME_DIAMETER[0] < measured_mm / listed_mm < SAME_DIAMETER[1]:
        return float(listed_mm)
    if not SAME_DIAGONAL[0] < diameter_of(mesh) / listed_mm < SAME_DIAGONAL[1]:
        raise StepError(
            f"model {path} measures {measured_mm:.4g} mm across, but {path.with_name('models_info.json')} says {listed_mm:.4g};"
            " the two do not belong together"
        )
    warn(
        f"{path.with_name('models_info.json')} lists {listed_mm:.4g} mm as the diameter of {path.name}, which is the diagonal of its box;"
        f" it measures {measured_mm:.4g} mm. Scores divide by the listed one, as BOP's do"
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
