"""A small results folder for tests of the report: one finished cell of the carton, one that failed, one half done."""

import json
import shutil
from pathlib import Path

import numpy as np

from helpers.carton_scene import Carton
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.report import gallery, object_page
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import write_json

LIMITS = {"registered_share": [0.9, 0.6], "f_score_1_percent": [0.8, 0.4], "recall_1_percent": [0.9, 0.4]}


def finished_cell(folder: Path, carton: Carton, nvs: str = "2dgs") -> Path:
    """The carton as an object's folder, su_h, colmap: its own model as the mesh that was made."""
    shutil.copytree(carton.model.parent, folder / "model")
    shutil.copytree(carton.capture, folder / "su_h/capture")
    for part in ("images", "masks"):
        shutil.copytree(carton.cameras / part, folder / "su_h/capture" / part)
    shutil.copytree(carton.cameras, folder / "su_h/colmap/cameras")
    write_json(
        folder / "su_h/colmap/cameras/registration.json", {"status": "ok", "registered": 10, "images": 10, "seconds": {"total": 3.5}}
    )
    cell = folder / "su_h/colmap" / nvs
    write_ply(cell / "mesh.ply", carton.mesh, "mesh.png")
    write_image(cell / "mesh.png", carton.mesh.texture)
    frame = {"object_from_registration": np.eye(4).tolist(), "scale": "known"}
    seconds = {"register": 3.5, "nvs": 20.0, "total": 23.5}
    write_json(
        cell / "mesh.json", {"scale": "known", "frame_facts": frame, "seconds": seconds, "parameters": {}, "versions": {"numpy": "2"}}
    )
    quality = {"accuracy_mm": 0.2, "completeness_mm": 0.3, "f_score_1_percent": 0.7, "psnr_db": 27.0}
    write_json(cell / "quality.json", quality)
    reason = "sparse: f_score_1_percent is 0.7, below 0.8, the limit of good (F-score at 1 % of the diameter)"
    judged = {"grade": "sparse", "reasons": [reason], "measures": {"f_score_1_percent": 0.7, "recall_1_percent": 0.95}}
    photos = {"grade": "good", "reasons": [], "measures": {"registered_share": 1.0}}
    write_json(
        cell / "grade.json",
        {"grade": "sparse", "judged_by": "truth", "reasons": [reason], "photos": photos, "truth": judged, "limits": LIMITS},
    )
    training = cell / "splats"
    training.mkdir()
    (training / "training.csv").write_text("iteration,count,loss,l1\n50,100,0.1,0.05\n100,120,0.05,0.02\n")
    write_json(training / "training.json", {"seconds": 20.0, "settings": {"iterations": 100}})
    (cell / "benchmarks").mkdir()
    (cell / "benchmarks/train.tsv").write_text("s\th:m:s\tmax_rss\tcpu_time\n20.5\t0:00:20\t812.5\t38.2\n")
    return cell


def failed_cell(folder: Path, reason: str) -> None:
    """A cell whose pictures could not be registered, as a table run leaves it."""
    write_failure([folder / "se/colmap/cameras", folder / "se/colmap/2dgs/outcome.json"], Failure("register.colmap", reason))


def half_done_cell(folder: Path) -> None:
    """A cell whose surface has been trained, and nothing else."""
    (folder / "su_l/colmap/cameras").mkdir(parents=True)
    (folder / "su_l/colmap/cameras/registration.json").write_text(json.dumps({"status": "ok", "registered": 10, "images": 10}))
    (folder / "su_l/colmap/2dgs/splats").mkdir(parents=True)
    (folder / "su_l/colmap/2dgs/splats/training.json").write_text(json.dumps({"seconds": 1.0, "settings": {}}))


def made_page(folder: Path, report: Path, *options: str) -> Path:
    """The page of an object, by the step's own command line."""
    out = report / "objects" / folder.name
    run(object_page, "--object", str(folder), "--out", str(out), *options)
    return out


def made_gallery(report: Path, *pages: Path, dataset: str = "demo", tables: Path | None = None) -> Path:
    """The gallery of these pages."""
    run(
        gallery,
        "--dataset",
        dataset,
        "--pages",
        *map(str, pages),
        "--out",
        str(report / "index.html"),
        *(["--tables", str(tables)] if tables else []),
    )
    return report / "index.html"


def run(module, *words: str) -> None:
    """Run a step with a command line."""
    import argparse

    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    module.run(parser.parse_args(words))
