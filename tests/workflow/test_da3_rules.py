"""Depth Anything 3 through the rules, with small random weights: everything but what it would have learned."""

import pytest

from helpers.small_da3 import write_weights
from zeroshop_steps.runtime.files import read_json

SMALL = "capture={image_width_px: 160, image_height_px: 120, views_per_ring: 3}"
CELL = "results/demo/gelatin_carton/se/da3"


@pytest.mark.slow
def test_random_weights_end_in_a_verdict(snakemake, tmp_path):
    write_weights(tmp_path / "resources/weights/DA3-SMALL/model.safetensors")
    run = snakemake(f"{CELL}/cameras", "--config", SMALL)
    assert run.returncode == 0, run.stdout
    record = read_json(tmp_path / CELL / "cameras/registration.json")
    assert record["status"] == "failed" and record["method"] == "da3" and record["images"] == 9 and record["refined_by"] == "none"
    assert record["reason"].startswith("matches connect 0 of 9 images, at least 8 are needed; and other views confirm only")
    assert record["parameters"]["colmap"]["sift"]["max_features"] == 4000 and record["predicted_peak_gb"] > 0
