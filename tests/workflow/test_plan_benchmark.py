"""What `snakemake -n` plans for the benchmark's test sets, detectors and estimators."""

import pytest

from helpers.plans import able
from helpers.running import planned
from zeroshop_steps import methods


def test_real_test_images_take_the_place_of_rendered_ones(snakemake):
    real = "--config", "datasets={ycbv: {test_folder: some/ycbv}}"
    run = snakemake("-n", "results/ycbv/bop/test", "results/demo/bop/test", *real)
    jobs = planned(run.stdout)
    assert jobs["real_test_set"] == jobs["test_set"] == 1 and "/some/ycbv --models results/ycbv/bop/models" in run.stdout
    run = snakemake("-n", "results/ycbv/bop/test", "--config", "datasets={ycbv: {test_folder: download}}")
    assert "--dataset ycbv  --models" in run.stdout


def test_the_table_of_robustness_damages_true_models(snakemake):
    run = snakemake("-n", "results/ycbv/tables/robustness.csv")
    jobs = planned(run.stdout)
    assert jobs["damaged_models"] == 7 and jobs["estimate_poses"] == jobs["score_poses"] == 8 and "reconstructed_models" not in jobs
    assert "--scale-percent -10 " in run.stdout and "--open-underside " in run.stdout


@pytest.mark.slow
def test_the_table_of_the_benchmark_runs_every_detector_and_estimator_on_every_set_of_models(snakemake):
    run = snakemake("-n", "results/demo/tables/bop.csv")
    assert run.returncode == 0, run.stdout
    assert all(f"{name} lacks" in run.stdout for name in ("cnos", "sam6d_ism", "foundationpose", "sam6d_pem"))
    jobs, sets, detectors = planned(run.stdout), 1 + able(methods.SURFACES), able(methods.DETECTORS)
    assert (jobs["contour"], jobs["score_detections"]) == (sets, sets * detectors)
    assert jobs["estimate_poses"] == jobs["score_poses"] == sets * able(methods.ESTIMATORS) * (1 + detectors)
    assert jobs["test_set"] == jobs["true_models"] == jobs["bop_table"] == 1
    commands = [line for line in run.stdout.splitlines() if "--method render_compare" in line]
    assert len(commands) == jobs["estimate_poses"]
    assert all(("--detections results/" in line) == ("render_compare-truth" not in line) for line in commands)
    assert not any("--detections --" in line for line in commands)
    named = snakemake("-n", "results/demo/bop/render_compare-cnos-models/poses.csv")
    assert named.returncode != 0 and "detector cnos cannot run here" in named.stdout


def test_poses_after_cnos_take_its_sure_masks_alone(snakemake, tmp_path):
    for name in methods.DETECTORS["cnos"].files:
        (tmp_path / methods.WEIGHTS_FOLDER / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / methods.WEIGHTS_FOLDER / name).touch()
    run = snakemake("-n", "results/demo/bop/render_compare-cnos-models/poses.csv")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout)["filter_masks"] == 1 and "--detections results/demo/bop/cnos-models/masks.json" in run.stdout


def test_poses_by_sam6d_are_planned_where_its_weights_are(snakemake, tmp_path):
    """With FastSAM's regions, so without the weights of SAM."""
    chosen = methods.DETECTORS["sam6d_ism"].with_options({"proposals": "fastsam"})
    for name in (*chosen.files, *methods.ESTIMATORS["sam6d_pem"].files):
        (tmp_path / methods.WEIGHTS_FOLDER / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / methods.WEIGHTS_FOLDER / name).touch()
    path = "results/demo/bop/sam6d_pem-sam6d_ism-models/scores.csv"
    run = snakemake("-n", path, "--config", "detect={sam6d_ism: {proposals: fastsam}}")
    assert run.returncode == 0, run.stdout
    jobs = planned(run.stdout)
    assert jobs["sam6d_ism"] == jobs["estimate_poses"] == jobs["templates"] == 1 and "filter_masks" not in jobs
    assert "--proposals fastsam" in run.stdout and "--templates results/demo/bop/templates/models/42" in run.stdout
    refused = snakemake("-n", path)
    assert refused.returncode != 0 and "sam-vit-huge/model.safetensors" in refused.stdout
