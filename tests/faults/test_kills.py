"""A run that is killed at any moment goes on where it stopped, and ends with the bytes of one that nobody disturbed."""

import hashlib
import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest

from helpers.running import command_and_environment, run_snakemake

pytestmark = [pytest.mark.faults, pytest.mark.slow, pytest.mark.timeout(3000)]

KILLS = 20
LONGEST_S = 9.0
"""Between two kills: the planning takes two seconds of it, so that most kills hit a step."""
PRODUCT = "results/demo/mug/2dgs.ply"
CONFIG = """
chosen: {virtual: {registration: truth}}
capture: {image_width_px: 320, image_height_px: 240}
nvs: {2dgs: {train: {iterations: 60, image_width_px: 160, sh_degree: 0}, fuse: {voxels: 64, image_width_px: 160}}}
finish: {texture_size_px: 256, clean: {max_faces: 3000}}
"""
TIMED = {".json", ".log", ".tsv", ".html", ".db"}
"""Files that hold seconds."""


def digests_of(folder: Path) -> dict[str, str]:
    """SHA-256 of every result that holds no seconds, by its path; of tables without their rows of seconds."""
    digests = {}
    for path in (folder / "results").rglob("*"):
        if path.is_file() and path.suffix not in TIMED:
            content = path.read_bytes()
            if path.suffix == ".csv":
                content = b"".join(line for line in content.splitlines(keepends=True) if b"seconds" not in line)
            digests[str(path.relative_to(folder))] = hashlib.sha256(content).hexdigest()
    return digests


def make(folder: Path) -> None:
    """Make the product, to the end."""
    run_snakemake(folder, "--unlock", "--configfile", "small.yaml")
    run = run_snakemake(folder, PRODUCT, "--rerun-incomplete", "--configfile", "small.yaml")
    assert run.returncode == 0, run.stdout


def test_twenty_kills_at_random_moments(tmp_path: Path) -> None:
    quiet, disturbed = tmp_path / "quiet", tmp_path / "disturbed"
    for folder in (quiet, disturbed):
        folder.mkdir()
        (folder / "small.yaml").write_text(CONFIG)
    make(quiet)
    moments, finished = random.Random(0), 0
    command, environment = command_and_environment(disturbed, PRODUCT, "--rerun-incomplete", "--configfile", "small.yaml")
    for _ in range(KILLS):
        run = subprocess.Popen(
            command, cwd=disturbed, env=environment, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(moments.uniform(1.0, LONGEST_S))
        finished += run.poll() is not None
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        run_snakemake(disturbed, "--unlock", "--configfile", "small.yaml")
        if finished:
            (disturbed / PRODUCT).unlink()
            finished = 0
    make(disturbed)
    left = [str(path) for path in (disturbed / "results").rglob(".*.part*")]
    assert digests_of(disturbed) == digests_of(quiet) and not left
