"""VGGT and Depth Anything 3 through the rules, with small random weights: everything but what they would have learned."""

import pytest

from helpers.pretend import pretend
from helpers.running import planned
from helpers.small_da3 import write_weights as write_da3_weights
from helpers.small_vggt import write_weights
from zeroshop_steps.runtime.files import read_json

SMALL = "capture={image_width_px: 160, image_height_px: 120, views_per_ring: 4}"
CELL = "results/demo/gelatin_carton/se/vggt"
DA3_CELL = "results/demo/gelatin_carton/se/da3"


@pytest.fixture
def with_weights(tmp_path):
    return write_weights(tmp_path / "resources/weights/VGGT-1B/model.safetensors")


def test_a_mesh_by_vggt_is_planned_where_the_weights_are(snakemake, with_weights):
    run = snakemake("-n", f"{CELL}/2dgs/mesh.ply")
    assert run.returncode == 0, run.stdout
    jobs = planned(run.stdout)
    assert jobs["register"] == jobs["stereo"] == jobs["train_2dgs"] == jobs["texture"] == 1
    assert "--method vggt" in run.stdout


@pytest.mark.slow
def test_other_weights_make_what_they_made_stale(snakemake, with_weights):
    cameras = f"{CELL}/cameras"
    pretend(snakemake, with_weights.parents[3], cameras)
    assert planned(snakemake("-n", cameras).stdout) == {}
    with_weights.write_bytes(with_weights.read_bytes() + b" ")
    assert planned(snakemake("-n", cameras).stdout) == {"register": 1}


@pytest.mark.slow
def test_random_weights_end_in_a_verdict_that_tables_show(snakemake, with_weights):
    config = (SMALL, "register={vggt: {tracked_points: 32, query_views: 2}}")
    root = with_weights.parents[3]
    write_da3_weights(root / "resources/weights/DA3-SMALL/model.safetensors")
    run = snakemake(f"{CELL}/2dgs/cell.csv", f"{DA3_CELL}/cameras", "--config", *config)
    assert run.returncode == 0, run.stdout
    record = read_json(root / DA3_CELL / "cameras/registration.json")
    assert record["status"] == "failed" and record["refined_by"] == "none" and record["predicted_peak_gb"] > 0
    assert record["reason"].startswith("matches hold 0 of 12 images, at least 10 are needed; and other views confirm only")
    assert record["parameters"]["colmap"]["sift"]["max_features"] == 4000
    record = read_json(root / CELL / "cameras/registration.json")
    assert record["status"] == "failed" and "of 12 images registered, at least 10 are needed" in record["reason"]
    assert record["query_views"] and record["tracks"] > 32
    row = (root / CELL / "2dgs/cell.csv").read_text()
    assert "of 12 images registered" in row and "none" in row
    direct = snakemake(f"{CELL}/2dgs/mesh.ply", "--config", *config)
    assert direct.returncode != 0 and "of 12 images registered" in direct.stdout
