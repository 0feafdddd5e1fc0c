"""A second checkout that shares the cache renders, registers and trains nothing again; damaged entries are made again."""

import shutil

import pytest

from helpers.checkout import copy_checkout
from helpers.planner import call_snakemake
from helpers.running import run_snakemake

CELL = "results/demo/mustard_bottle/se/truth"
SPLATS = f"{CELL}/2dgs/splats/splats.ply"
LOGS = [
    "results/demo/mustard_bottle/se/logs/capture.log",
    *(f"{CELL}/{log}.log" for log in ("logs/register", "stereo/logs/stereo", "2dgs/logs/train")),
]
CONFIG = [
    "capture={image_width_px: 160, image_height_px: 120, views_per_ring: 6}",
    "nvs={2dgs: {train: {iterations: 20, image_width_px: 80, sh_degree: 0}}}",
]


def checkout(folder):
    """A copy of the project in a folder of its own, and a call of Snakemake there that makes the splats."""
    environment = copy_checkout(folder)

    def make(shared):
        shares = {**environment, "ZEROSHOP_CACHE": str(shared)}
        run = call_snakemake(folder, ["--cores", "2", SPLATS, "--config", *CONFIG], shares)
        assert run.returncode == 0, run.stdout
        return [(folder / log).read_text() for log in LOGS], (folder / SPLATS).read_bytes()

    return make


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_second_checkout_makes_no_registration_and_no_training_again(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    logs, splats = checkout(tmp_path / "first")(shared)
    assert not any("taken from the cache" in log for log in logs)
    assert len(list(shared.iterdir())) == 4
    second = checkout(tmp_path / "far" / "away" / "second")
    logs, again = second(shared)
    assert all("taken from the cache" in log for log in logs), logs
    assert again == splats

    [training] = shared.glob("surface.twodgs-*")
    (training / "content/splats.ply").write_bytes(splats[:-40] + bytes(40))
    shutil.rmtree(tmp_path / "far/away/second/results")
    logs, rebuilt = second(shared)
    assert "was damaged" in logs[3] and "taken from the cache" not in logs[3]
    assert rebuilt == splats, "never used, made again"


@pytest.mark.parametrize("place", ["absent", "file"])
def test_an_unusable_cache_ends_the_run_before_it_starts(tmp_path, monkeypatch, place):
    (tmp_path / "file").touch()
    monkeypatch.setenv("ZEROSHOP_CACHE", str(tmp_path / place))
    run = run_snakemake(tmp_path, "-n", "results/demo/mug/2dgs.ply")
    assert run.returncode != 0
    assert f"the cache {tmp_path / place} is no folder" in run.stdout and "or unset it" in run.stdout
