"""FoundationPose through the rules, with small random weights: everything but what it would have learned."""

import shutil

import pytest

from helpers.running import planned
from helpers.small_dataset import CAN, make_dataset
from helpers.small_foundationpose import write_checkpoints
from zeroshop_steps.bop.formats.estimates import read_estimates
from zeroshop_steps.bop.formats.targets import Target, write_targets

NAMED = ("--config", "tables={estimators: [foundationpose], detectors: [contour], nvs: [2dgs]}")


def test_the_table_of_the_benchmark_is_planned_where_the_weights_are(snakemake, tmp_path):
    refused = snakemake("-n", "results/ycbv/tables/bop.csv", *NAMED)
    assert refused.returncode != 0 and "model_best.pth" in refused.stdout and "drive.google.com" in refused.stdout
    write_checkpoints(tmp_path)
    run = snakemake("-n", "results/ycbv/tables/bop.csv", *NAMED)
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout)["estimate_poses"] == 4, "true and reconstructed models, true and detected masks"
    assert "--method foundationpose" in run.stdout
    run = snakemake("-n", "results/ycbv/tables/bop.csv", *NAMED, "pose={foundationpose: {iterations: 3}}")
    assert run.returncode == 0 and "--iterations 3" in run.stdout, "options of the step that the schema does not describe"


@pytest.mark.slow
def test_poses_are_estimated_by_the_rule(snakemake, tmp_path):
    write_checkpoints(tmp_path)
    made = make_dataset(tmp_path / "made")
    write_targets(made.targets_path, [Target(1, 0, CAN, 1)])
    folder = tmp_path / "results/demo/bop"
    folder.mkdir(parents=True)
    for part in ("models", "test", "test_targets_bop19.json"):
        shutil.move(made.folder / part, folder / part)
    target = "results/demo/bop/foundationpose-truth-models/poses.csv"
    only = ["--rerun-triggers", "mtime", "--allowed-rules", "estimate_poses", "--config", "pose={foundationpose: {iterations: 1}}"]
    run = snakemake(target, *only)
    log = folder / "foundationpose-truth-models/logs/poses.log"
    assert run.returncode == 0, run.stdout + (log.read_text() if log.exists() else "")
    assert len(read_estimates(tmp_path / target)) == 1
