"""Every profile plans the same jobs, and a step that is killed is told from one that fails."""

import contextlib
import signal
import subprocess
import time

import psutil
import pytest

from helpers.paths import REPOSITORY
from helpers.running import command_and_environment, planned


@pytest.mark.parametrize("profile", ["default", "gpu", "gpu12", "slurm"])
def test_a_profile_changes_how_jobs_run_and_not_which(snakemake, profile):
    run = snakemake(
        "-n", "--workflow-profile", str(REPOSITORY / "workflow/profiles" / profile), "results/demo/mug/su_l/truth/2dgs/mesh.ply"
    )
    assert run.returncode == 0, run.stdout
    chain = ["demo_model", "capture_virtual", "register", "stereo", "train_2dgs", "fuse_2dgs", "shape", "texture"]
    assert planned(run.stdout) == dict.fromkeys(chain, 1)


@pytest.mark.slow
def test_a_killed_step_is_a_clear_failure_with_a_remedy(tmp_path):
    """SIGKILL is what a process gets when memory has run out."""
    command, environment = command_and_environment(tmp_path, "results/demo/mug/model")
    run = subprocess.Popen(command, cwd=tmp_path, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    killed, started_s = False, time.monotonic()
    while not killed and run.poll() is None and time.monotonic() - started_s < 120:
        for child in psutil.Process(run.pid).children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):  # gone meanwhile
                if child.cmdline()[1:3] == ["-m", "zeroshop_steps.synthetic"]:
                    child.send_signal(signal.SIGKILL)
                    killed = True
        time.sleep(0.05)
    output = run.communicate(timeout=120)[0]
    assert killed and run.returncode != 0
    assert "error: the step was killed or crashed, most often because memory or the disk ran out; give it more" in output
    assert not (tmp_path / "results/demo/mug/model").exists()
