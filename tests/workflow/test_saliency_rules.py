"""The salient-object network of the config reaches registration and segmentation; the default one may be missing, others may not."""

import json
import shutil
from pathlib import Path

import pytest

from helpers.ball_scene import write_ball_scene
from helpers.paths import REPOSITORY
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT, NETWORKS

SEGMENTED = "results/photos/ball/video/auto/cameras"
OBJECT = "results/photos/ball/video_segmented/capture"
FILE = NETWORKS[DEFAULT].path


@pytest.fixture
def plan(snakemake, tmp_path):
    """The shell lines that a dry run plans for targets with a value of segment.saliency.network, and all that was said."""
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/a.png").touch()
    table = tmp_path / "objects.tsv"
    rows = (
        "dataset\tobject\timages\tmasks\theight_m",
        f"photos\tball\t{tmp_path}/photos\t\t",
        f"photos\tmasked\t{tmp_path}/photos\t{tmp_path}\t",
    )
    table.write_text("\n".join(rows) + "\n")

    def run(*targets, network=DEFAULT, config=()):
        segment = json.dumps({"saliency": {"network": network}})
        ended = snakemake("-n", *targets, "--config", f"objects_table={table}", f"segment={segment}", *config)
        return [line for line in ended.stdout.splitlines() if "python -m zeroshop_steps" in line], ended.stdout

    return run


def lines_of(lines, step):
    return [line for line in lines if f"zeroshop_steps.{step} " in line]


def test_a_missing_default_network_is_said_and_the_rest_goes_on(plan, tmp_path):
    lines, said = plan(SEGMENTED)
    assert "--method support_plane" in lines_of(lines, "segment")[0] and "--network" not in "".join(lines)
    assert said.count("warning: objects are found without a salient-object network") == 1
    assert f"`snakemake {FILE}` downloads it (5 MB, licence Apache-2.0)" in said
    (tmp_path / FILE).parent.mkdir(parents=True)
    (tmp_path / FILE).write_bytes(b"short")
    lines, said = plan(SEGMENTED)
    assert "--method support_plane" in lines_of(lines, "segment")[0] and "it is cut short" in said


def test_a_network_that_was_asked_for_must_be_there(plan):
    for network, config, message in (
        ("u2net", (), "the weights resources/weights/saliency/u2net.onnx are not there"),
        ("no such.onnx", (), "no such.onnx does not exist; segment.saliency.network (--network) is the ONNX file"),
        (DEFAULT, ("segmentation=saliency",), "u2netp.onnx are not there"),
        ("none", ("segmentation=saliency",), "segment.saliency.network is none; name a network: u2netp"),
    ):
        lines, said = plan(SEGMENTED, network=network, config=config)
        assert not lines and message in said, said


def test_no_network_is_a_choice(plan):
    lines, said = plan(SEGMENTED, network="none")
    assert "--method support_plane" in lines_of(lines, "segment")[0] and "warning" not in said


def test_a_file_of_the_users_is_given_to_both_steps(plan, tmp_path):
    network = tmp_path / "my network.onnx"
    network.touch()
    lines, _ = plan(SEGMENTED, OBJECT, "results/photos/masked/video/auto/cameras", network=str(network))
    registered, masked = sorted(lines_of(lines, "register"), key=lambda line: "/masked/" in line)
    assert "my network.onnx'" in registered and "--network" not in masked, "given masks need no network"
    segmented = [line for line in lines_of(lines, "segment") if "--method saliency" in line]
    assert len(segmented) == 1 and "my network.onnx'" in segmented[0]
    [captured] = [line for line in lines if "--method object_capture" in line]
    assert "--segmentation saliency --options" in captured and "my network.onnx'" in captured


@pytest.mark.slow
def test_another_file_of_the_network_makes_what_it_gave_stale(snakemake, plan, tmp_path):
    """With the real network, where the set-up has it."""
    if not (REPOSITORY / FILE).is_file():
        pytest.skip(f"{FILE} is not there; `snakemake {FILE}` downloads it")
    shutil.copytree((REPOSITORY / FILE).parent, (tmp_path / FILE).parent)
    (tmp_path / "results/photos/ball/video/capture").mkdir(parents=True)
    write_ball_scene(tmp_path / "results/photos/ball/video/colmap/scene")
    target = SEGMENTED.replace("auto", "colmap")
    table = f"objects_table={tmp_path}/objects.tsv"
    assert snakemake(target, "--config", table).returncode == 0
    record = json.loads((tmp_path / target / "segmentation.json").read_text())
    assert record["method"] == "saliency" and record["network"] == "u2netp.onnx"
    assert "Nothing to be done" in snakemake("-n", target, "--config", table).stdout
    (tmp_path / FILE).touch()
    assert "--method saliency" in snakemake("-n", target, "--config", table).stdout
    (tmp_path / FILE).unlink()
    assert "--method support_plane" in snakemake("-n", target, "--config", table).stdout
    assert Path(tmp_path / target).is_dir()
