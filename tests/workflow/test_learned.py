"""Learned methods through the real rules, with small random weights: everything but what a network has learned."""

import json
import sys

import numpy as np
import pytest
import torch
from running import REPOSITORY, planned

from zeroshop_steps.files import write_json
from zeroshop_steps.images import write_image

sys.path.insert(0, str(REPOSITORY / "tests" / "parity"))

from mast3r_cases import SMALL, parameters  # noqa: E402

from zeroshop_steps.networks.mast3r.model import Configuration, MASt3R  # noqa: E402


@pytest.fixture
def photos(tmp_path):
    """Eight photos of noise, shifted from one to the next, and the options that make the workflow read them."""
    noise = np.random.default_rng(0).integers(0, 255, (72, 200, 3), dtype=np.uint8)
    for number in range(8):
        write_image(tmp_path / "mine" / f"{number}.png", noise[:, 5 * number : 5 * number + 96])
    (tmp_path / "objects.tsv").write_text(f"dataset\tobject\timages\tmasks\theight_m\nphotos\tcup\t{tmp_path / 'mine'}\t\t\n")
    return ["--config", f"objects_table={tmp_path / 'objects.tsv'}"]


def test_mast3r_with_random_weights_ends_with_a_record(snakemake, photos, tmp_path):
    with torch.device("meta"):
        network = MASt3R(Configuration(**SMALL))
    weights = tmp_path / "own weights.pth"
    torch.save({"model": parameters({name: tuple(tensor.shape) for name, tensor in network.state_dict().items()})}, weights)
    write_json(weights.with_suffix(".json"), SMALL)
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
