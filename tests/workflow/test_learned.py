"""Learned methods through the real rules, with small random weights: everything but what a network has learned."""

import json
import shutil

import numpy as np
import pytest
import torch

from helpers.mast3r_cases import SMALL, parameters
from helpers.running import planned
from zeroshop_steps.geometry.cameras.object_crops import fit_object_sphere
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.networks.mast3r.model import MASt3R, Mast3rSettings
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.surface.mvs.seeds import Seeds, write_seeds
from zeroshop_steps.surface.rendering.training_views import make_grid_view, make_seed_views, read_camera_set


@pytest.fixture
def photos(tmp_path):
    """Eight photos of noise, shifted from one to the next, and the options that make the workflow read them."""
    noise = np.random.default_rng(0).integers(0, 255, (72, 200, 3), dtype=np.uint8)
    for number in range(8):
        write_image(tmp_path / "mine" / f"{number}.png", noise[:, 5 * number : 5 * number + 96])
    (tmp_path / "objects.tsv").write_text(f"dataset\tobject\timages\tmasks\theight_m\nphotos\tcup\t{tmp_path / 'mine'}\t\t\n")
    return ["--config", f"objects_table={tmp_path / 'objects.tsv'}"]


@pytest.fixture
def weights(tmp_path):
    """Small random weights of MASt3R, their sizes beside them."""
    with torch.device("meta"):
        network = MASt3R(Mast3rSettings(**SMALL))
    path = tmp_path / "own weights.pth"
    torch.save({"model": parameters({name: tuple(tensor.shape) for name, tensor in network.state_dict().items()})}, path)
    write_json(path.with_suffix(".json"), SMALL)
    return path


@pytest.mark.slow
def test_mast3r_with_random_weights_ends_with_a_record(snakemake, photos, weights, tmp_path):
    target = "results/photos/cup/video/mast3r/scene"
    assert "lacks the weights" in snakemake("-n", target, *photos).stdout
    own = f"register={{mast3r: {{weights: {weights}, long_side_px: 64, min_confidence: 0.0, min_track: 2}}}}"
    run = snakemake(target, *photos, own)
    log = tmp_path / target.replace("scene", "logs/register.log")
    assert run.returncode == 0, run.stdout + (log.read_text() if log.exists() else "")
    assert planned(run.stdout) == {"capture_photos": 1, "register_photos": 1}
    record = json.loads((tmp_path / target / "registration.json").read_text())
    assert record["method"] == "mast3r" and record["status"] == "failed" and record["images"] == 8
    assert record["matches"] > 0, "a network of noise finds matches; geometry rejects them"
    assert {"encode", "match", "verify"} <= set(record["seconds"])


@pytest.mark.slow
def test_the_height_by_mast3r_with_random_weights_ends_with_its_reason(snakemake, photos, weights, carton, tmp_path):
    """The cell is there up to its raw mesh; photos of noise stand for the empty scene."""
    row = f"photos\tcup\t{tmp_path / 'mine'}\t\t\tmast3r\t{tmp_path / 'mine'}\n"
    (tmp_path / "objects.tsv").write_text("dataset\tobject\timages\tmasks\theight_m\theight_method\tmarker_images\n" + row)
    scene = tmp_path / "results/photos/cup/video"
    write_json(scene / "capture" / "capture.json", {})
    shutil.copytree(carton.cameras, scene / "colmap" / "cameras")
    write_ply(scene / "colmap" / "2dgs" / "raw_mesh.ply", carton.mesh)
    camera_set = read_camera_set(carton.cameras)
    sphere = fit_object_sphere(camera_set.model.cameras, camera_set.masks)
    sizes = {view.camera.name: make_grid_view(view).mask.shape for view in make_seed_views(camera_set, sphere)}
    nothing = {name: np.zeros(shape, np.float32) for name, shape in sizes.items()}
    hull = VisualHull(np.ones((8, 8, 8), bool), 1.0)
    (scene / "colmap" / "stereo").mkdir()
    write_seeds(scene / "colmap" / "stereo" / "seeds.npz", Seeds(*[np.zeros((0, 3))] * 3, nothing, hull), sphere)
    target = "results/photos/cup/video/colmap/2dgs/height.json"
    only = ["--rerun-triggers", "mtime", "--allowed-rules", "shape", *photos]
    assert "lacks the weights" in snakemake("-n", target, *only).stdout
    run = snakemake(target, *only, f"height={{mast3r: {{weights: {weights}, long_side_px: 64}}}}")
    assert planned(run.stdout) == {"shape": 1}
    log = (tmp_path / target.replace("height.json", "logs/shape.log")).read_text()
    assert run.returncode == 0 and "looking at pairs: 30/30" in log
    assert "match none of the others" in read_failure(tmp_path / target).reason and "Traceback" not in log
    assert f"{target}: height.mast3r: " in run.stdout.split("recorded in place of results (1):")[1]
