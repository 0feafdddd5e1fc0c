"""Two runs at once in one folder: the second ends at once and says what to do."""

import os
import signal
import subprocess
import time

import pytest

from helpers.running import command_and_environment, run_snakemake


@pytest.mark.slow
def test_the_second_run_in_a_folder_says_that_it_is_locked(tmp_path):
    target = "results/demo/mug/model"
    command, environment = command_and_environment(tmp_path, target)
    first = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT, start_new_session=True
    )
    try:
        started_s = time.monotonic()
        while not list(tmp_path.glob(".snakemake/locks/*")) and first.poll() is None and time.monotonic() - started_s < 120:
            time.sleep(0.05)
        os.killpg(first.pid, signal.SIGSTOP)
        second = run_snakemake(tmp_path, target)
    finally:
        os.killpg(first.pid, signal.SIGCONT)
    assert second.returncode != 0
    assert "cannot be locked" in second.stdout and "no other Snakemake process" in second.stdout and "--unlock" in second.stdout
    assert first.wait(timeout=300) == 0, "the first is not disturbed"
    assert (tmp_path / target / "model.ply").is_file()
