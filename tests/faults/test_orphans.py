"""A run that was killed alone leaves its step alive: the folder is unlocked and the next run makes the same file beside it."""

import subprocess
import time
from pathlib import Path

import psutil
import pytest

from helpers.running import command_and_environment, run_snakemake

TARGET = "results/demo/mug/model"


@pytest.mark.slow
def test_a_folder_is_unlocked_while_an_orphan_writes(tmp_path: Path) -> None:
    command, environment = command_and_environment(tmp_path, TARGET)
    first = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    # Its log is there as soon as the step starts. What it writes is there for milliseconds only.
    while not (tmp_path / "results/demo/mug/logs/model.log").is_file():
        assert first.poll() is None
        time.sleep(0.01)
    orphans = psutil.Process(first.pid).children(recursive=True)
    for orphan in orphans:
        orphan.suspend()
    first.kill()
    first.wait()
    locked = run_snakemake(tmp_path, TARGET)
    assert locked.returncode != 0 and "--unlock" in locked.stdout and "Traceback" not in locked.stdout, locked.stdout
    assert run_snakemake(tmp_path, "--unlock", TARGET).returncode == 0
    second = run_snakemake(tmp_path, TARGET)
    assert second.returncode == 0, second.stdout
    made = {path.name: path.read_bytes() for path in (tmp_path / TARGET).iterdir()}
    for orphan in orphans:
        orphan.resume()
    psutil.wait_procs(orphans, timeout=60)
    left = {path.name: path.read_bytes() for path in (tmp_path / TARGET).iterdir() if path.name != ".snakemake_timestamp"}
    assert left == {name: content for name, content in made.items() if name != ".snakemake_timestamp"}
    assert not list((tmp_path / "results").rglob(".*.part*"))
