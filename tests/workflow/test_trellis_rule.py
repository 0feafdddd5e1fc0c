"""The rules of trellis, with cameras and without, and of a generated mesh that completes a measured one, with small random weights."""

import json
import shutil

import numpy as np
import pytest

from helpers.running import planned
from helpers.small_trellis import write_encoder, write_networks
from zeroshop_steps import methods
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.runtime.files import write_json

CELL = "results/photos/box/video/colmap"
SMALL = {"trellis": {"networks": "small-trellis", "encoder": "small-dino", "generations": 1, "steps": 2, "device": "cpu"}}


@pytest.fixture
def registered(tmp_path, carton):
    """A folder in which the carton is registered and has a mesh by 2dgs, and the options that name it and the small networks."""
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/a.png").touch()
    (tmp_path / "objects.tsv").write_text(f"dataset\tobject\timages\tmasks\theight_m\nphotos\tbox\t{tmp_path}/photos\t\t0.09\n")
    write_json(tmp_path / "results/photos/box/video/capture/capture.json", {})
    shutil.copytree(carton.cameras, tmp_path / CELL / "cameras")
    write_ply(tmp_path / CELL / "2dgs/raw_mesh.ply", carton.mesh)
    options = ["--config", f"objects_table={tmp_path / 'objects.tsv'}", f"nvs={json.dumps(SMALL)}"]
    return ["--rerun-triggers", "mtime", *options]


@pytest.mark.slow
def test_the_rule_runs_with_small_random_networks(snakemake, registered, tmp_path):
    target = f"{CELL}/trellis/raw_mesh.ply"
    missing = snakemake("-n", f"{CELL}/trellis/clean.ply", *registered)
    assert missing.returncode != 0 and "lacks the weights resources/weights/small-trellis" in missing.stdout, missing.stdout
    write_networks(tmp_path / "resources/weights/small-trellis")
    write_encoder(tmp_path / "resources/weights/small-dino")
    run = snakemake(target, *registered, "--allowed-rules", "train_trellis")
    log = (tmp_path / f"{CELL}/trellis/logs/train.log").read_text()
    assert run.returncode == 0 and planned(run.stdout) == {"train_trellis": 1}, run.stdout + log
    assert "structure (steps)" in log and "latents (steps)" in log and "Traceback" not in log
    record = json.loads((tmp_path / target).with_suffix(".json").read_text())
    mesh = read_ply(tmp_path / target)
    assert record["generated"] and len(record["views"]) == 2 and record["faces"] == len(mesh.faces) and mesh.colors is not None


@pytest.mark.slow
def test_without_cameras_the_mesh_is_finished_and_as_high_as_the_user_says(snakemake, registered, carton, tmp_path):
    write_networks(tmp_path / "resources/weights/small-trellis")
    write_encoder(tmp_path / "resources/weights/small-dino")
    for part in ("images", "masks"):
        shutil.copytree(carton.cameras / part, tmp_path / "results/photos/box/video/capture" / part)
    cell = "results/photos/box/video/none/trellis"
    run = snakemake(f"{cell}/raw_mesh.ply", *registered, "--allowed-rules", "train_without_cameras_trellis")
    log = tmp_path / f"{cell}/logs/train_without_cameras.log"
    assert run.returncode == 0 and "Traceback" not in log.read_text(), run.stdout + log.read_text()
    record, mesh = json.loads((tmp_path / cell / "raw_mesh.json").read_text()), read_ply(tmp_path / cell / "raw_mesh.ply")
    assert (record["unit"], record["scale"], record["height_m"], len(record["views"])) == ("millimetre", "known", 0.09, 2)
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(90.0, abs=1e-3) and mesh.colors is not None
    closed = snakemake("-n", f"{cell}/closed.ply", *registered)
    assert closed.returncode != 0 and "or with mesh.ply where that was generated: all else needs cameras" in closed.stdout
    rules = [f"{name}_without_cameras" for name in ("finish", "evaluate")]
    chosen = [*registered, "chosen={photos: {registration: none}}", "finish={texture_size_px: 256}"]
    run = snakemake("results/photos/box/trellis.ply", *chosen, "--allowed-rules", *rules, "publish")
    assert run.returncode == 0 and planned(run.stdout) == dict.fromkeys([*rules, "publish"], 1), run.stdout
    facts, mesh = (
        json.loads((tmp_path / "results/photos/box/trellis.json").read_text()),
        read_ply(tmp_path / "results/photos/box/trellis.ply"),
    )
    assert (facts["generated"], facts["grade"]["grade"], facts["area_shares"]["unseen"]) == (True, "none", 1.0)
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(90.0, abs=1e-3) and mesh.is_textured and not mesh.seen_faces().any()


def test_a_generated_mesh_completes_a_measured_one_where_that_is_asked_for(snakemake, registered, tmp_path):
    target = f"{CELL}/2dgs/closed.ply"
    plain = snakemake("-n", target, *registered)
    assert plain.returncode == 0 and "--generated  --stereo" in plain.stdout and "train_trellis" not in plain.stdout, plain.stdout
    wanted = [*registered, "finish={unseen: generated}"]
    refused = snakemake("-n", target, *wanted)
    assert refused.returncode != 0 and "trellis cannot run here, it lacks" in refused.stdout, refused.stdout
    method = methods.SURFACES["trellis"].with_options(SMALL["trellis"])
    for path in (tmp_path / "resources/weights" / file for file in method.files):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    run = snakemake("-n", target, *wanted)
    assert run.returncode == 0 and f"--generated {CELL}/trellis/raw_mesh.ply" in run.stdout, run.stdout
