"""Planned faults: what a user or a machine does wrong, and the ending that each must have."""

import contextlib
import re
import resource
import subprocess
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError

CLEAR = "clear"


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        name: what is wrong, in a few words.
        run: prepares the fault in an empty folder, does what a user would do, and returns the status of that; a StepError is what
            a command prints as its error.
        says: regular expressions that the message must hold: the file, what was expected, the remedy.
    """

    name: str
    run: Callable[[Path], int | None]
    says: tuple[str, ...]


def step(stage: str, method: str, *words: object, **options: object) -> int:
    """Call a step as a rule does; returns its status."""
    argv = ["--method", method, *map(str, words)]
    for name, value in options.items():
        argv += [f"--{name.replace('_', '-')}", str(value)]
    return stage_main(f"zeroshop_steps.{stage}", argv)


def judge(fault: Fault, folder: Path, capture: pytest.CaptureFixture[str]) -> str:
    """How a fault ends: CLEAR, or what is wrong with its ending, with the text that was printed."""
    status: int | None
    try:
        status = fault.run(folder)
        text = capture.readouterr().err
    except StepError as error:
        status, text = 1, str(error)
    except SystemExit as stop:
        status, text = int(stop.code or 0), capture.readouterr().err
    except Exception:
        status, text = 1, traceback.format_exc()
    left = [path.name for path in folder.rglob("*") if ".part" in path.name]
    faults = []
    if not status:
        faults.append("silent: the status is 0")
    if "Traceback (most recent call last)" in text:
        faults.append("a traceback")
    if left:
        faults.append(f"half-written: {left}")
    faults += [f"it does not say {words!r}" for words in fault.says if not re.search(words, text)]
    return "; ".join(faults) + f"\n{text}" if faults else CLEAR


@contextlib.contextmanager
def small_disk(folder: Path, size_bytes: int) -> Iterator[Path]:
    """A file system of its own with so much room, mounted on `folder`; skips the test where it may not be mounted."""
    folder.mkdir(parents=True, exist_ok=True)
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size_bytes}", "tmpfs", str(folder)], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"no small file system can be mounted here: {mounted.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@contextlib.contextmanager
def largest_file(size_bytes: int) -> Iterator[None]:
    """No file of this process may become larger, as under `ulimit -f`."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
