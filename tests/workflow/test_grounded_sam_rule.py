"""`segmentation: auto` takes the networks that are there or that the config names, and the rule runs with small random ones."""

import json
from pathlib import Path

import pytest

from zeroshop_steps import methods

TARGET = "results/photos/ball/video/colmap/cameras"


@pytest.fixture
def photographed(tmp_path):
    """A folder in which a ball is registered, and the options that name it and the small models."""
    from helpers.ball_scene import write_ball_scene

    table = tmp_path / "objects.tsv"
    table.write_text(f"dataset\tobject\timages\tmasks\theight_m\tprompt\nphotos\tball\t{tmp_path}/photos\t\t\tred ball's middle.\n")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/a.png").touch()
    (tmp_path / "results/photos/ball/video/capture").mkdir(parents=True)
    write_ball_scene(tmp_path / "results/photos/ball/video/colmap/scene")
    models = json.dumps({"grounded_sam": {"detector": "small-dino", "tracker": "small-sam"}})
    return "--config", f"objects_table={table}", f"segment={models}"


@pytest.mark.slow
def test_what_auto_means_depends_on_the_weights(snakemake, tmp_path, photographed):
    run = snakemake("-n", TARGET, *photographed)
    assert run.returncode == 0 and "--method support_plane" in run.stdout, run.stdout
    assert "warning: objects are found without a salient-object network" in run.stdout
    named = snakemake("-n", TARGET, *photographed, "segmentation=grounded_sam")
    assert named.returncode != 0 and "lacks the weights resources/weights/small-dino/model.safetensors" in named.stdout
    for file in methods.SEGMENTATIONS["grounded_sam"].with_options({"detector": "small-dino", "tracker": "small-sam"}).files:
        path = tmp_path / "resources/weights" / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    run = snakemake("-n", TARGET, *photographed)
    assert "--method grounded_sam" in run.stdout and "--tracker small-sam" in run.stdout, run.stdout
    assert "--prompt 'red ball'\"'\"'s middle.'" in run.stdout
    run = snakemake("-n", "results/photos/ball/video_segmented/capture", *photographed)
    [line] = [line for line in run.stdout.splitlines() if "--method object_capture" in line]
    assert "--segmentation grounded_sam --options --" in line and "--tracker small-sam" in line, line


@pytest.mark.slow
def test_the_rule_runs_with_small_random_networks(snakemake, tmp_path, photographed):
    from helpers.small_networks import write_detector, write_tracker

    write_detector(tmp_path / "resources/weights/small-dino")
    write_tracker(tmp_path / "resources/weights/small-sam")
    run = snakemake(TARGET, *photographed)
    assert run.returncode == 0, run.stdout
    record = json.loads((tmp_path / TARGET / "segmentation.json").read_text())
    assert record["method"] == "grounded_sam" and record["prompt"] == "red ball's middle." and record["good_masks"] == 12
    assert len(list(Path(tmp_path / TARGET / "masks").iterdir())) == 12
