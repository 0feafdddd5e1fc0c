"""All stages: the command `zeroshop` on a capture as its user would run it, measured, and its mesh against the references."""

import hashlib
import json
import shutil
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_benchmark.commands import run_command
from capture_benchmark.inputs import find_inputs
from capture_benchmark.mask_stage import describe_capture
from capture_benchmark.pictures import draw_masks, draw_six_sides
from capture_benchmark.references import read_references
from capture_benchmark.scores import UNEXPECTED, MaskScores, compare_masks, name_outcome
from capture_benchmark.table import Capture
from zeroshop_steps.geometry.cameras.pinhole import align_to_truth, pair_with_truth, read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.geometry.imaging.images import compute_overlap, list_images, write_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.register.scene.record import read_registration
from zeroshop_steps.runtime.code_version import SOURCES
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import read_json, write_json

ZEROSHOP = "import sys; from zeroshop_steps.app.command import main; sys.exit(main())"
REGISTRATION, SURFACE = "video/auto", "2dgs"
MESH_PICTURE, MASK_PICTURE = "mesh.jpg", "mesh_masks.jpg"
REFUSED, NO_GRADE = "Failed", "none"


def find_source(capture: Capture, data: Path, inputs: Path) -> Path:
    """What its user would give: the folder of photos or the film."""
    folder = find_inputs(inputs, capture)
    if capture.kind == "real":
        return data / capture.path
    return folder / "film" / "film.mp4" if capture.kind == "film" else folder / "capture" / "images"


def run_all(capture: Capture, options: tuple[str, ...], data: Path, inputs: Path, cores: int, out: Path) -> dict[str, Any]:
    """Run `zeroshop` on a capture in `out`/run unless that was done by the same code with the same options.

    A run that was interrupted goes on where it stopped.
    """
    source, record = find_source(capture, data, inputs), out / "mesh.json"
    key = make_key(source, options, capture.height_m)
    started = out / "mesh.started"
    if record.is_file() and (earlier := read_json(record)).get("key") == key:
        return earlier
    if not started.is_file() or started.read_text() != key:
        shutil.rmtree(out / "run", ignore_errors=True)
        out.mkdir(parents=True, exist_ok=True)
        started.write_text(key)
    record.unlink(missing_ok=True)
    height = ["--height", f"{capture.height_m:g}"] if capture.height_m else []
    words = [
        sys.executable,
        "-c",
        ZEROSHOP,
        source,
        "--into",
        out / "run",
        "--name",
        capture.name,
        "--cores",
        str(cores),
        *height,
        *options,
    ]
    usage = run_command(words, out / "mesh.log")
    facts: dict[str, Any] = {"key": key, **{name: round(value, 2) for name, value in asdict(usage).items()}}
    write_json(record, facts)
    return facts


def make_key(source: Path, options: tuple[str, ...], height_m: float | None) -> str:
    """What a mesh depends on: the photos, the options, and all of the package's code."""
    digest = hashlib.sha256(json.dumps([options, height_m]).encode())
    for path in sorted(path for path in SOURCES.rglob("*") if path.suffix in (".py", ".json", ".csv")):
        digest.update(path.read_bytes())
    for path in [source] if source.is_file() else sorted(path for path in source.iterdir() if path.is_file()):
        digest.update(f"{path.name} {path.stat().st_size}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def judge_mesh(capture: Capture, facts: dict[str, Any], data: Path, inputs: Path, drawn: Path, out: Path) -> dict[str, Any]:
    """The capture's row of the results table; pictures of its masks and of the mesh are drawn beside.

    A mesh of grade `none` counts as refused: its user is told not to use it.
    """
    results = out / "run" / "results" / "photos" / capture.name
    run, taken, stored = results / REGISTRATION, results / "video" / "capture", find_inputs(inputs, capture)
    mesh_path = results / f"{SURFACE}.ply"
    row = describe_capture(capture) | {"photos": len(list_images(taken / "images")) if taken.is_dir() else 0, "registered": 0}
    mask_scores, mesh_scores = MaskScores({}, 0), MaskScores({}, 0)
    refusal = _find_refusal(out / "mesh.log", facts["status"], mesh_path)
    grade = (read_json(mesh_path.with_suffix(".json")).get("grade") or {}) if mesh_path.is_file() else {}
    if refusal is None and grade.get("grade") == NO_GRADE:
        refusal = "grade none: " + "; ".join(grade.get("reasons", []))
    psnr_db = None
    if (run / "scene").is_dir() and read_failure(run / "scene") is None:
        row["registered"] = read_registration(run / "scene")["registered"]
    if (run / "cameras" / "masks").is_dir():
        references = read_references(capture, stored, data, drawn, run / "scene", taken)
        mask_scores = compare_masks(run / "cameras" / "masks", [path.stem for path in list_images(run / "scene" / "images")], references)
        write_image(out / MASK_PICTURE, draw_masks(run / "scene", run / "cameras", references, mask_scores.overlaps))
        if mesh_path.is_file():
            object_from_registration = np.array(read_json(mesh_path.with_suffix(".json"))["frame_facts"]["object_from_registration"])
            mesh = read_ply(mesh_path)
            views = [
                replace(view, camera=transform_camera(view.camera, object_from_registration)) for view in read_views(run / "cameras")[0]
            ]
            mesh_scores = compare_silhouettes(MeshRenderer(mesh), views, references)
            psnr_db = measure_held_out(mesh_path, run, stored)
            write_image(out / MESH_PICTURE, draw_six_sides(mesh))
    figures = mask_scores.describe("mask_iou") | mesh_scores.describe("mesh_iou")
    row["outcome"] = name_outcome(capture, refusal, figures["mesh_iou_median"], figures["mesh_iou_worst"])
    row |= {"reason": refusal or "", "left_out": mask_scores.left_out, "references": len(mesh_scores.overlaps), **figures}
    row |= {"psnr_db": psnr_db, "grade": grade.get("grade")}
    return row | {name: facts[name] for name in ("wall_s", "cpu_s", "memory_mb")} | {"method": SURFACE}


def compare_silhouettes(renderer: MeshRenderer, views: list[View], references: dict[str, np.ndarray]) -> MaskScores:
    """The mesh's silhouettes against reference masks; cameras of the views are in the frame of the mesh."""
    found = {Path(view.camera.name).stem: view.camera for view in views}
    overlaps = {
        stem: compute_overlap(renderer.cast_rays(found[stem]).mask, references[stem]) for stem in sorted(references) if stem in found
    }
    return MaskScores(overlaps, 0)


def measure_held_out(mesh_path: Path, run: Path, stored: Path) -> float | None:
    """Mean PSNR, in dB, of the mesh's renderings in held-out photos, on the object, after a gain of each colour; None without such photos.

    The gain is fitted, since each photo has an exposure and white balance of its own.
    """
    held_out = stored / "capture" / "held_out"
    if not (held_out / "truth").is_dir():
        return None
    truth = read_sparse_model(stored / "capture" / "truth").cameras
    registered = [view.camera for view in read_views(run / "cameras")[0]]
    truth_from_registration = align_to_truth(pair_with_truth(registered, truth))
    object_from_registration = np.array(read_json(mesh_path.with_suffix(".json"))["frame_facts"]["object_from_registration"])
    object_from_truth = object_from_registration @ np.linalg.inv(truth_from_registration)
    renderer, values = MeshRenderer(read_ply(mesh_path)), []
    for view in read_views(held_out, sparse="truth")[0]:
        mask, photo = view.mask(), view.image().astype(float)
        rendered, silhouette = renderer.render_masked_color(transform_camera(view.camera, object_from_truth))
        both = mask & silhouette
        if not both.any():
            values.append(0.0)
            continue
        gain = photo[both].mean(0) / np.maximum(rendered[both].astype(float).mean(0), 1.0)
        shown = np.where(silhouette[..., None], np.clip(rendered * gain, 0, 255), 0.0)
        values.append(10 * np.log10(255.0**2 / max(float(np.mean((shown[mask] - photo[mask]) ** 2)), 1e-9)))
    return round(float(np.mean(values)), 2) if values else None


def _find_refusal(log: Path, status: int, mesh: Path) -> str | None:
    """Why there is no mesh; None where there is one."""
    if not status and mesh.is_file():
        return None
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    reasons = [line.removeprefix(REFUSED).strip() for line in lines if line.startswith((REFUSED, "error:"))]
    return "; ".join(reasons) if reasons else f"{UNEXPECTED}end: {lines[-1] if lines else 'without a word'}"
