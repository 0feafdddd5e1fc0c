"""In a table run, a step that cannot do its work leaves a record in place of its outputs, so that the other cells go on.

The record is one line of JSON with the step and its reason. A later step that is given one passes it on, down to the cell's
outcome.json; a step without `--record-failure` ends with its reason instead, so that no finished mesh is ever a record.

Recording is switched on by the workflow, for runs that make a table; a step that is run alone fails as any command does.
What the machine did wrong is never recorded, since it says nothing about the cell: a full disk, no memory, a killed process.
"""

import json
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError, is_out_of_memory
from zeroshop_steps.runtime.files import atomic_write

SWITCH = "ZEROSHOP_RECORD_FAILURES"
START = b'{"failed": "'


@dataclass(frozen=True)
class Failure:
    """Which step failed and why."""

    step: str
    reason: str

    def __str__(self) -> str:
        return f"{self.step}: {self.reason}"


def recording() -> bool:
    """Whether this run makes a table."""
    return bool(os.environ.get(SWITCH))


def write_failure(outputs: Iterable[Path], failure: Failure) -> None:
    """Leave the record in place of every output."""
    for path in outputs:
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps({"failed": failure.step, "reason": failure.reason}) + "\n")


def read_failure(path: Path) -> Failure | None:
    """The failure that a file records; None where it is a true output, a folder or absent."""
    try:
        with Path(path).open("rb") as file:
            if file.read(len(START)) != START:
                return None
        record = json.loads(Path(path).read_text())
        return Failure(record["failed"], record["reason"])
    except (OSError, ValueError, KeyError):
        return None


def failure_among(words: Sequence[str]) -> Failure | None:
    """The first failure that a file on a command line records."""
    return next((failure for failure in map(read_failure, map(Path, words)) if failure), None)


def is_result(error: BaseException) -> bool:
    """Whether an error says something about the cell, and not about the machine."""
    machine = (OSError, MemoryError, ImportError)
    # Libraries raise these as errors of their own or as RuntimeErrors.
    by_words = is_out_of_memory(error) or "CUDA error" in str(error) or "start new thread" in str(error)
    return isinstance(error, Exception) and not by_words and not isinstance(error, machine) and not isinstance(error.__cause__, machine)


def reason_of(error: BaseException) -> str:
    """An error in the words of a table: one line, without the colours that some libraries put into theirs."""
    text = str(error) if isinstance(error, StepError) else f"unexpected {type(error).__name__}: {error}"
    return " ".join(re.sub(r"\x1b\[[0-9;]*m", "", text).split())
