"""Evaluate a finished mesh: what of it was measured, its grade, a preview, and its errors where the truth is known.

Each is a module of its own: quality.py, grade.py and finish/preview.py. A mesh that was generated without cameras was
never seen, and its grade is none.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.evaluate.grade import add_limits, judge_mesh, make_ungraded_record, read_limits, write_grade
from zeroshop_steps.evaluate.quality import GroundTruth, make_quality_record, write_quality
from zeroshop_steps.finish.preview import draw_around, draw_preview
from zeroshop_steps.geometry.cameras.registered_views import View, choose_standing, read_mask_record, read_views
from zeroshop_steps.geometry.cameras.transforms import transform_camera, transform_points
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.support_classes import MEASURED, UNSEEN, compute_area_shares
from zeroshop_steps.geometry.observation.vertex_support import classify_surface_support
from zeroshop_steps.runtime.compute.kernel_devices import DEVICES, choose_kernel_device
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import part_of_step
from zeroshop_steps.runtime.files import Record, atomic_write, read_json
from zeroshop_steps.surface.mvs.seeds import read_confirmed_points

EVIDENCE, QUALITY, PREVIEW = "evidence.npz", "quality.json", "mesh_preview.png"
"""What is written beside grade.json."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="finished mesh.ply with its JSON beside it")
    parser.add_argument("--cameras", type=Path, help="registered cameras with images and masks; none for a mesh generated without")
    parser.add_argument("--stereo", type=Path, nargs="?", help="seeds.npz with the depths that stereo confirmed, if there are any")
    parser.add_argument("--model", type=Path, help="folder of the true model.ply and model_info.json, if there is one")
    parser.add_argument("--capture", type=Path, help="virtual capture of that model, with truth/ and held_out/, or that of a film")
    parser.add_argument("--film-truth", type=Path, nargs="?", help="truth of the rendered film that the capture was made from")
    parser.add_argument("--device", choices=DEVICES, default="cpu", help="where the mesh is rasterized (default: %(default)s)")
    add_limits(parser)
    parser.add_argument(
        "--out", type=Path, required=True, help=f"grade.json; a tidy CSV, {EVIDENCE}, {PREVIEW} and, with --model, {QUALITY} go beside it"
    )


def run(args: argparse.Namespace) -> None:
    """Evaluate one mesh."""
    limits = read_limits(args)
    if args.model and not args.capture:
        raise StepError("--model is given without --capture; the capture has the true cameras, give both or none")
    device = choose_kernel_device(args.device)
    mesh, metadata = read_ply(args.mesh), read_json(args.mesh.with_suffix(".json"))
    if args.cameras is None:
        _evaluate_unseen(args.out, mesh, metadata, limits)
        return
    registered, _ = read_views(args.cameras)
    object_from_registration = np.array(metadata["frame_facts"]["object_from_registration"])
    views = [replace(view, camera=transform_camera(view.camera, object_from_registration)) for view in registered]
    with part_of_step("evaluate.surface_support"):
        mesh = _write_support(args.out, mesh, classify_finished_mesh(mesh, metadata, registered, args.stereo, device))
    quality = None
    if args.model:
        with part_of_step("evaluate.quality"):
            quality = _measure_against_truth(args, mesh, metadata, registered)
    with part_of_step("evaluate.grade"):
        start_s, record = time.monotonic(), read_json(args.cameras / "registration.json")
        missed_px = read_mask_record(args.cameras).get("outlines_miss_px")
        content = judge_mesh(mesh, metadata, views, record["images"] - len(record.get("foreign", [])), quality, limits, missed_px)
        write_grade(args.out, content | {"device": device, "seconds": round(time.monotonic() - start_s, 2)})
    with part_of_step("finish.preview"):
        write_image(args.out.with_name(PREVIEW), draw_preview(mesh, views))
    print(f"grade: {content['grade']} {'; '.join(content['reasons'])}", file=sys.stderr)


def _evaluate_unseen(out: Path, mesh: Mesh, metadata: Record, limits: dict[str, tuple[float, float]]) -> None:
    """Evaluate a mesh that was generated without cameras."""
    if not metadata.get("generated"):
        raise StepError(f"{metadata.path} is of a mesh that was made with cameras, and its grade needs them; give them as --cameras")
    _write_support(out, mesh, np.full(len(mesh.vertices), UNSEEN, np.uint8))
    write_grade(out, make_ungraded_record(limits))
    write_image(out.with_name(PREVIEW), draw_around(mesh))


def _write_support(out: Path, mesh: Mesh, evidence: np.ndarray) -> Mesh:
    """Write the class of every vertex; returns the mesh with them as quality."""
    with atomic_write(out.with_name(EVIDENCE)) as temporary:
        np.savez_compressed(temporary, evidence=evidence)
    supported = replace(mesh, quality=evidence / MEASURED)
    shares = compute_area_shares(supported)
    print("evidence: " + ", ".join(f"{share:.1%} {name}" for name, share in shares.items()), file=sys.stderr)
    return supported


def _measure_against_truth(args: argparse.Namespace, mesh: Mesh, metadata: Record, registered: list[View]) -> dict:
    """Write quality.json; returns its content."""
    start_s, model, film = time.monotonic(), args.model / "model.ply", args.film_truth
    truth = GroundTruth.read_film(args.capture, model, film) if film else GroundTruth.read(args.capture, model)
    figures = make_quality_record(mesh, metadata, tuple(view.camera for view in choose_standing(registered)), truth)
    write_quality(args.out.with_name(QUALITY), figures | {"seconds": round(time.monotonic() - start_s, 2)})
    print(
        f"quality: accuracy {figures['accuracy_mm']} mm, completeness {figures['completeness_mm']} mm, "
        f"F at 1 % {figures['f_score_1_percent']}",
        file=sys.stderr,
    )
    return figures


def classify_finished_mesh(
    mesh: Mesh, metadata: dict[str, Any], views: Sequence[View], stereo: Path | None, device: str = "cpu"
) -> np.ndarray:
    """(V,) uint8 class of each vertex.

    Args:
        mesh: in the object frame.
        metadata: content of mesh.json.
        views: the registered photos, in their own frame.
        stereo: seeds.npz with the depths that stereo confirmed, if there are any.
        device: where the mesh is rasterized.

    Raises:
        StepError: `stereo` is missing, damaged or of other cameras.
    """
    confirmed = read_confirmed_points(stereo, views) if stereo else np.zeros((0, 3))
    registration_from_object = np.linalg.inv(np.array(metadata["frame_facts"]["object_from_registration"]))
    registered = Mesh(transform_points(mesh.vertices, registration_from_object), mesh.faces)
    return drop_generated(classify_surface_support(registered, views, confirmed, device), mesh, metadata)


def drop_generated(evidence: np.ndarray, mesh: Mesh, metadata: dict[str, Any]) -> np.ndarray:
    """(V,) the classes, with vertices that only generated faces have, which are the mesh's last ones, as never seen.

    What a generated mesh proposed is never seen, whatever photos show.
    """
    if (metadata.get("closing") or {}).get("method") != "generated":
        return evidence
    kept = np.zeros(len(mesh.vertices), bool)
    kept[mesh.faces[: metadata["underside"]["first_face"]]] = True
    return np.where(kept, evidence, UNSEEN).astype(np.uint8)
