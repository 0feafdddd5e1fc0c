"""A step that a library or the kernel ends says what ran out, and leaves nothing."""

import contextlib
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

from faults.photos import take_photos
from helpers.faults import small_disk
from helpers.paths import REPOSITORY
from zeroshop_steps.runtime.child_process import explain_end
from zeroshop_steps.runtime.errors import explain_machine_fault
from zeroshop_steps.runtime.temporary import remove_abandoned, temporary_file, temporary_folder

ROOM_BYTES = 20 << 20
"""Enough for the check before COLMAP begins, with eight images."""


def call_register(images: Path, out: Path) -> subprocess.Popen[str]:
    words = ["-m", "zeroshop_steps.register", "--method", "colmap", "--capture", str(images), "--scene", "video", "--out", str(out)]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY / "src")}
    return subprocess.Popen([sys.executable, *words], env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def test_a_disk_that_becomes_full_while_colmap_writes(tmp_path: Path) -> None:
    take_photos(tmp_path, 640, 480).rename(tmp_path / "images")

    def fill_once_it_writes(disk: Path, run: subprocess.Popen[str]) -> None:
        while not list(disk.glob(".colmap*/database.db")) and run.poll() is None:
            time.sleep(0.01)
        with contextlib.suppress(OSError), (disk / "filler").open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))

    with small_disk(tmp_path / "disk", ROOM_BYTES) as disk:
        run = call_register(tmp_path, disk / "cameras")
        filling = threading.Thread(target=fill_once_it_writes, args=(disk, run))
        filling.start()
        text = run.communicate(timeout=120)[1]
        filling.join()
        assert run.returncode == 1
        assert "disk" in text and "Check free disk space (df -h" in text and "Traceback" not in text, text
        assert [path.name for path in disk.iterdir()] == ["filler"]


def test_a_killed_step_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    """The kernel kills the process that takes the most memory, which is the child."""
    take_photos(tmp_path, 640, 480).rename(tmp_path / "images")
    run = call_register(tmp_path, tmp_path / "cameras")
    while not list(tmp_path.glob(".colmap*")) and run.poll() is None:
        time.sleep(0.01)
    [child] = psutil.Process(run.pid).children()
    child.kill()
    text = run.communicate(timeout=60)[1]
    assert run.returncode == 1
    assert "error: the step was killed, most often because memory ran out" in text, text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["images"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_step_does_not_outlive_its_parent(tmp_path: Path, number: signal.Signals) -> None:
    take_photos(tmp_path, 640, 480).rename(tmp_path / "images")
    run = call_register(tmp_path, tmp_path / "cameras")
    while not (children := psutil.Process(run.pid).children()):
        time.sleep(0.01)
    run.send_signal(number)
    run.communicate(timeout=60)
    psutil.wait_procs(children, timeout=30)
    assert not children[0].is_running()
    assert not (tmp_path / "cameras").exists()


def test_other_causes_are_named(tmp_path: Path) -> None:
    text = explain_end(signal.SIGSEGV, [tmp_path])
    assert "ended by a library (SIGSEGV" in text and "memory" in text and "fewer or smaller images" in text


@pytest.mark.parametrize(
    ("limit_mb", "says"),
    [
        (1500, "ulimit -v allows 1500 MB, .*Any object needs 2000 MB"),
        (3600, "enough for 100 megapixels in all.*20 images of 5.0 megapixels"),
    ],
)
def test_memory_that_ran_out_says_what_would_fit(monkeypatch: pytest.MonkeyPatch, limit_mb: int, says: str) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (limit_mb * 10**6, -1))
    monkeypatch.setattr(Path, "read_text", lambda path: "MemAvailable: 99000000 kB\n")
    text = explain_machine_fault(MemoryError())
    assert text and re.search(says, text) and "fewer or smaller images" in text, text


def test_what_a_living_process_holds_stays(tmp_path: Path) -> None:
    (tmp_path / ".left.0123abcd.part.png").touch()
    (tmp_path / ".left.0123abcd.part").mkdir()
    (tmp_path / ".hidden.part").touch()
    with temporary_file(tmp_path / "own.png") as file, temporary_folder(tmp_path, "own") as folder:
        remove_abandoned(tmp_path)
        assert sorted(path.name for path in tmp_path.iterdir()) == sorted([".hidden.part", file.name, folder.name])
