"""Measure the finished mesh of a virtual capture or of a rendered film against the truth.

The mesh is aligned with the truth by the cameras (the similarity from registered to true camera centres), never by ICP, which would
hide a wrong pose. Accuracy is the mean distance from the mesh to the true surface; an underside that was closed without being seen
does not count. Completeness is the mean distance from the true surface, as far as two cameras see it, to the mesh. The F-score
combines both at a threshold. PSNR compares held-out photos, which films lack, with unlit renderings of the mesh, within the bounding
box of the mask; each is black outside its own silhouette. The scale error compares the scale from the known height with that of the
cameras; the other figures do not depend on it, because the alignment includes the scale.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.finish.closing.underside import drop_underside
from zeroshop_steps.geometry.alignment.surface_distance import measure_surface_error
from zeroshop_steps.geometry.cameras.pinhole import Camera, align_to_truth, pair_with_truth, read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_camera, transform_points
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.runtime.tables import write_table
from zeroshop_steps.synthetic.film_truth import read_true_cameras

LARGEST = 0.99  # quantile of the distances that counts as the largest error: that of a hole, a dent or a lid on a hundredth
SAMPLES = 3  # rays along each side of a pixel in the renderings


@dataclass(frozen=True)
class GroundTruth:
    """What a mesh is compared with, in the true frame, in mm.

    Attributes:
        surface: the true model.
        diameter_mm: of the model.
        support_z_mm: height of the support plane; None without one.
        cameras: true cameras of the photos; registered ones are matched by file stem.
        held_out: photos that the reconstruction did not use.
    """

    surface: Mesh
    diameter_mm: float
    support_z_mm: float | None
    cameras: tuple[Camera, ...]
    held_out: list[View]

    @staticmethod
    def read(capture: Path, model: Path) -> "GroundTruth":
        """Read the truth of a virtual capture of a model, or of films of all of its passes."""
        surface = read_ply(model)
        on_ground = read_json(capture / "capture.json")["scene"] != "se"
        return GroundTruth(
            surface,
            read_json(model.with_name("model_info.json"))["diameter"],
            float(surface.vertices[:, 2].min()) if on_ground else None,
            read_sparse_model(capture / "truth").cameras,
            read_views(capture / "held_out", sparse="truth")[0] if (capture / "held_out" / "truth").is_dir() else [],
        )

    @staticmethod
    def read_film(capture: Path, model: Path, film_truth: Path) -> "GroundTruth":
        """Read the truth of a capture made from a rendered film of a model, which stands on a table."""
        surface = read_ply(model)
        diameter_mm = read_json(model.with_name("model_info.json"))["diameter"]
        return GroundTruth(surface, diameter_mm, float(surface.vertices[:, 2].min()), read_true_cameras(capture, film_truth), [])


def make_quality_record(mesh: Mesh, metadata: dict, registered: tuple[Camera, ...], truth: GroundTruth) -> dict:
    """The content of quality.json.

    Args:
        mesh: textured, in the object frame.
        metadata: content of mesh.json.
        registered: the registered cameras, of the first pass, in their own frame.
        truth: what the mesh is compared with.
    """
    facts = metadata["frame_facts"]
    figures = measure_quality(drop_underside(mesh, metadata), np.array(facts["object_from_registration"]), registered, truth)
    figures["scale_known"] = facts["scale"] == "known"
    if not figures["scale_known"]:
        figures["scale_error_percent"] = None
    # The time that the mesh took is copied here, so that this file has all that the tables show.
    took, cpu = metadata.get("seconds", {}), metadata.get("cpu_seconds", {})
    costs = {"training_seconds": took.get("nvs"), "training_cpu_seconds": cpu.get("nvs"), "mesh_seconds": took.get("total")}
    return figures | {name: value for name, value in costs.items() if value is not None}


def write_quality(path: Path, content: dict) -> None:
    """Write quality.json and, beside it, its figures as a tidy CSV."""
    write_json(path, content)
    measured = {
        key: value for key, value in content.items() if key != "seconds" and isinstance(value, int | float) and not isinstance(value, bool)
    }
    write_table(path.with_suffix(".csv"), [{"measure": key, "value": value} for key, value in measured.items()])


def measure_quality(mesh: Mesh, object_from_registration: np.ndarray, registered: tuple[Camera, ...], truth: GroundTruth) -> dict:
    """All figures of one mesh, as the module describes them.

    Args:
        mesh: textured, in the object frame.
        object_from_registration: (4, 4) similarity.
        registered: the registered cameras, of the first pass.
        truth: what it is compared with.
    """
    truth_from_registration = align_to_truth(pair_with_truth(registered, truth.cameras))
    truth_from_object = truth_from_registration @ np.linalg.inv(object_from_registration)
    aligned = Mesh(transform_points(mesh.vertices, truth_from_object), mesh.faces)
    error = measure_surface_error(aligned, truth.surface, list(truth.cameras), truth.support_z_mm)
    one_percent_mm = 0.01 * truth.diameter_mm
    up_in_truth = truth_from_object[:3, 2] / np.linalg.norm(truth_from_object[:3, 2])
    rotation_scale = compute_scale(truth_from_object)
    figures = {
        "accuracy_mm": error.to_truth_mm.mean(),
        "accuracy_median_mm": np.median(error.to_truth_mm),
        "completeness_mm": error.to_mesh_mm.mean(),
        "completeness_median_mm": np.median(error.to_mesh_mm),
        "f_score_2_mm": error.f_score(2.0),
        "f_score_1_percent": error.f_score(one_percent_mm),
        "precision_1_percent": error.precision(one_percent_mm),
        "recall_1_percent": error.recall(one_percent_mm),
        "largest_error_percent": 100.0 * error.largest_mm(LARGEST) / truth.diameter_mm,
        "normal_error_deg": error.normal_deg.mean(),
        "seen_share": error.seen_share,
        "scale_error_percent": (1.0 / rotation_scale - 1.0) * 100.0,
        "up_error_deg": np.degrees(np.arccos(np.clip(up_in_truth[2], -1.0, 1.0))),
        "faces": len(mesh.faces),
    }
    if truth.held_out:
        figures |= _measure_appearance(mesh, np.linalg.inv(truth_from_object), truth.held_out)
    return {key: round(float(value), 5) if not isinstance(value, int | list) else value for key, value in figures.items()}


def _measure_appearance(mesh: Mesh, object_from_truth: np.ndarray, held_out: list[View]) -> dict:
    """PSNR within the bounding box of the mask, and intersection over union of the silhouettes; means over the held-out photos."""
    renderer = MeshRenderer(mesh)
    psnr, iou = [], []
    for view in held_out:
        mask, camera = view.mask(), transform_camera(view.camera, object_from_truth)
        rendered, silhouette = renderer.render_masked_color(camera, SAMPLES)
        photo = np.where(mask[..., None], view.image(), 0)
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        psnr.append(10.0 * np.log10(255.0**2 / max(np.mean((rendered[box].astype(float) - photo[box]) ** 2), 1e-9)))
        iou.append((silhouette & mask).sum() / max((silhouette | mask).sum(), 1))
    return {"psnr_db": np.mean(psnr), "silhouette_iou": np.mean(iou), "psnr_db_views": [round(value, 3) for value in psnr]}
