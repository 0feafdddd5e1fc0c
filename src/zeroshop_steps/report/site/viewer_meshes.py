"""The 3D content of an object's page: its meshes with distances to the true model, the true model, cameras and points."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.alignment.surface_distance import count_seeing_views, measure_distances
from zeroshop_steps.geometry.cameras.pinhole import align_to_truth, make_transform, pair_with_truth, read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import read_first_cameras
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_points
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.report.site.html import format_method
from zeroshop_steps.report.site.mesh_reduction import ReducedMesh, reduce_mesh
from zeroshop_steps.report.site.results_index import Cell, Run
from zeroshop_steps.report.site.viewer_data import encode_array, encode_mesh, encode_scene, quantize_distances, write_data
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

LIMIT_DIAMETERS = 0.02
"""End of the colour scale of distances: twice the threshold of the F-score."""


class TrueModel:
    """The true model of an object and its reduced copy, which all runs share."""

    def __init__(self, folder: Path, max_faces: int, texture_px: int) -> None:
        self.mesh = read_ply(folder / "model.ply")
        self.diameter_mm = float(read_json(folder / "model_info.json")["diameter"])
        self.reduced = reduce_mesh(self.mesh, max_faces, texture_px)

    @property
    def limit_mm(self) -> float:
        """The distance at the end of the colour scale."""
        return LIMIT_DIAMETERS * self.diameter_mm


def read_true_model(folder: Path, max_faces: int, texture_px: int) -> TrueModel | None:
    """The true model in `folder`; None if there is none, as for photos, or, with a warning, if it is damaged."""
    if not (folder / "model.ply").is_file():
        return None
    try:
        return TrueModel(folder, max_faces, texture_px)
    except (StepError, KeyError, ValueError) as error:
        warn(f"the true model in {folder} is left out: {error}")
        return None


def write_meshes(runs: list[Run], truth: TrueModel | None, out: Path, max_faces: int, texture_px: int) -> dict:
    """Write the meshes of all finished cells, the true model and the cameras of each run. Returns the manifest for the viewer."""
    manifest: dict = {"diameter_mm": truth.diameter_mm if truth else None, "runs": []}
    if truth:
        write_data(out / "truth.js", encode_mesh(truth.reduced))
    for run in runs:
        panes, frames, entry = [], {}, {"key": run.key, "scene": run.scene, "registration": run.registration}
        for cell in (cell for cell in run.cells if cell.state != "failed" and (cell.folder / "mesh.ply").is_file()):
            try:
                frames[cell.key] = read_object_frame(cell)
                panes.append(_write_cell(cell, run, truth, out, max_faces, texture_px))
            except StepError as error:
                warn(f"{cell.key} is left out of the viewer: {error}")
        if panes:
            manifest["runs"].append(entry | {"panes": panes, "scene_file": _write_scene(run, panes, frames, out)})
    manifest["truth"] = "truth.js" if truth else None
    write_data(out / "viewer.js", manifest)
    return manifest


def read_object_frame(cell: Cell) -> np.ndarray:
    """(4, 4) object_from_registration of a finished cell. Raises StepError if mesh.json lacks it."""
    try:
        return np.array(cell.facts["mesh"]["frame_facts"]["object_from_registration"], np.float64).reshape(4, 4)
    except (KeyError, TypeError, ValueError):
        raise StepError(f"{cell.folder / 'mesh.json'} has no frame; delete it and make the mesh again") from None


def compute_truth_from_object(cell: Cell, run: Run) -> np.ndarray:
    """(4, 4) similarity from the object frame to the true frame, by the cameras."""
    registered = read_first_cameras(run.folder / "cameras")
    true_cameras = read_sparse_model(run.capture / "truth").cameras
    return align_to_truth(pair_with_truth(registered, true_cameras)) @ np.linalg.inv(read_object_frame(cell))


def _write_scene(run: Run, panes: list[dict], frames: dict[str, np.ndarray], out: Path) -> str | None:
    """Write the cameras and points of a run in the frame of its first pane, and add to each pane its transform; returns the file."""
    first = frames[panes[0]["key"]]
    try:
        write_data(out / f"scene-{run.key}.js", encode_scene(read_sparse_model(run.folder / "cameras/sparse"), first))
    except StepError as error:
        warn(f"the cameras of {run.key} are left out of the viewer: {error}")
        return None
    for pane in panes:
        pane["object_from_scene"] = (frames[pane["key"]] @ np.linalg.inv(first)).round(6).tolist()
    return f"scene-{run.key}.js"


def _write_cell(cell: Cell, run: Run, truth: TrueModel | None, out: Path, max_faces: int, texture_px: int) -> dict:
    mesh = read_ply(cell.folder / "mesh.ply")
    small = reduce_mesh(mesh, max_faces, texture_px)
    file = f"mesh-{cell.key}.js"
    pane: dict[str, Any] = {"key": cell.key, "title": format_method(cell.nvs), "grade": cell.grade, "file": file, "faces": len(mesh.faces)}
    pane["known_scale"] = cell.facts["mesh"].get("scale") == "known"
    if truth is None:
        write_data(out / file, encode_mesh(small))
        return pane
    similarity = compute_truth_from_object(cell, run)
    away = measure_distances(truth.mesh, _transform_mesh(small.mesh, similarity).vertices)
    away[_find_unseen(small, mesh, cell.facts["mesh"].get("underside") or {})] = np.nan
    content = encode_mesh(small, away, truth.limit_mm)
    missing = measure_distances(_transform_mesh(mesh, similarity), truth.reduced.mesh.vertices)
    missing[~_find_seen(truth, run)] = np.nan
    content["truth_distances"] = encode_array(quantize_distances(missing, truth.limit_mm))
    write_data(out / file, content)
    pane["object_from_truth"] = _invert_rigidly(similarity).round(6).tolist()
    return pane


def _transform_mesh(mesh: Mesh, transform: np.ndarray) -> Mesh:
    return replace(mesh, vertices=transform_points(mesh.vertices, transform))


def _invert_rigidly(similarity: np.ndarray) -> np.ndarray:
    """The inverse of a similarity without its scale, so that the true model keeps its size."""
    rotation = similarity[:3, :3] / compute_scale(similarity)
    return make_transform(rotation.T, -rotation.T @ similarity[:3, 3])


def _find_unseen(small: ReducedMesh, mesh: Mesh, underside: dict) -> np.ndarray:
    """(V,) whether a reduced vertex lies on the underside that was closed without being seen: the mesh's last faces."""
    first = underside.get("first_face")
    if first is None or underside.get("seen", True):
        return np.zeros(len(small.mesh.vertices), bool)
    answer = ray_caster((mesh.vertices, mesh.faces)).compute_closest_points(o3d.core.Tensor(small.mesh.vertices.astype(np.float32)))
    return answer["primitive_ids"].numpy().astype(np.int64) >= first


def _find_seen(truth: TrueModel, run: Run) -> np.ndarray:
    """(V,) whether at least two cameras see a vertex of the reduced true model."""
    cameras = list(read_sparse_model(run.capture / "truth").cameras)
    capture = read_json(run.capture / "capture.json")
    support = float(truth.mesh.vertices[:, 2].min()) if str(capture["scene"]).startswith("su_") else None
    model = truth.reduced.mesh
    return count_seeing_views(model.vertices, model.vertex_normals, truth.mesh, cameras, support) >= 2
