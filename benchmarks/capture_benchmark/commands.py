"""Run a step as a command, and measure it."""

import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

KB_A_MB = 1024


@dataclass(frozen=True)
class Usage:
    """What a command took.

    Attributes:
        status: how it ended; 0 is well.
        wall_s, cpu_s: seconds, the latter of all its processes and threads.
        memory_mb: the most that one of its processes held.
    """

    status: int
    wall_s: float
    cpu_s: float
    memory_mb: float


def run_step(words: Sequence[str | Path], log: Path, environment: Mapping[str, str] | None = None) -> Usage:
    """Run `python -m zeroshop_steps.WORDS`, its output in a log file."""
    return run_command([sys.executable, "-m", f"zeroshop_steps.{words[0]}", *words[1:]], log, environment)


def run_command(words: Sequence[str | Path], log: Path, environment: Mapping[str, str] | None = None) -> Usage:
    """Run a command, its output in a log file."""
    log.parent.mkdir(parents=True, exist_ok=True)
    start_s = time.monotonic()
    with log.open("wb") as output:
        process = subprocess.Popen(
            list(map(str, words)), stdout=output, stderr=subprocess.STDOUT, env={**os.environ, **(environment or {})}
        )
        try:
            _, status, used = os.wait4(process.pid, 0)
        except BaseException:
            process.terminate()
            process.wait()
            raise
    process.returncode = os.waitstatus_to_exitcode(status)
    return Usage(process.returncode, time.monotonic() - start_s, used.ru_utime + used.ru_stime, used.ru_maxrss / KB_A_MB)


def last_line(log: Path) -> str:
    """The last line of a log that says something, for a reason."""
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return lines[-1] if lines else "it ended without a word"
