"""CNOS with FastSAM, and SAM-6D's poses, through the rules with small random weights: everything but what they would have learned."""

import shutil

import pytest

from helpers.running import planned
from helpers.small_dataset import CAN, make_dataset
from helpers.small_detectors import save_describer, save_fastsam
from helpers.small_sam6d import write_pem
from zeroshop_steps.bop.formats.detections import read_detections
from zeroshop_steps.bop.formats.estimates import read_estimates
from zeroshop_steps.bop.formats.targets import Target, write_targets

RULES = ("templates", "cnos", "estimate_poses")
SMALL = "detect={cnos: {proposals: fastsam, describer: small}}"


@pytest.mark.slow
def test_detections_and_poses_by_random_networks_come_out_of_the_rules(snakemake, tmp_path):
    weights = tmp_path / "resources/weights"
    save_fastsam(weights)
    save_describer(weights, "small")
    write_pem(weights / "sam-6d-pem-base.pth")
    made, folder = make_dataset(tmp_path / "made"), tmp_path / "results/demo/bop"
    write_targets(made.targets_path, [Target(1, 0, CAN, 1)])
    folder.mkdir(parents=True)
    for part in ("models", "test", "test_targets_bop19.json"):
        shutil.move(made.folder / part, folder / part)
    ends = ["cnos-models/detections.json", "sam6d_pem-truth-models/poses.csv"]
    run = snakemake(*(f"results/demo/bop/{end}" for end in ends), "--rerun-triggers", "mtime", "--allowed-rules", *RULES, "--config", SMALL)
    logs = "".join(log.read_text() for log in folder.glob("*/logs/*.log"))
    assert run.returncode == 0 and "Traceback" not in logs, run.stdout + logs
    assert logs.count("have no texture") == 2, "the models of this dataset have none, and work"
    assert planned(run.stdout) == dict.fromkeys(RULES, 1)
    assert all(one.image_id == 0 for one in read_detections(folder / ends[0])), "the images of the targets alone"
    assert len(read_estimates(folder / ends[1])) == 1
