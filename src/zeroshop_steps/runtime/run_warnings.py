"""What steps warned of and which failures they recorded during a run of the workflow, repeated at its end.

Nobody opens the log of a step that succeeded, and one whose failure is recorded counts as such.
"""

import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from zeroshop_steps.runtime.errors import WARNING, StepError
from zeroshop_steps.runtime.failures import RECORDED, how_to_try_again, read_failure

SHOWN = 30  # lines at the end of a run; all are in the logs
PICTURES = {"images", "masks", "depth", "truth"}
"""Folders with many files and no logs."""
FINISHED = "mesh"
"""The finished mesh of a cell and the files beside it: mesh.ply, .png, .glb and .json."""


def warnings_since(folder: Path, start_s: float) -> list[str]:
    """ "LOG: warning" of each line in the logs below `folder` that were written at `start_s` (seconds since the epoch) or later."""
    return [f"{log}: {line.removeprefix(WARNING)}" for log, line in _lines_since(folder, start_s) if line.startswith(WARNING)]


def failures_since(folder: Path, start_s: float) -> list[str]:
    """ "RECORD: step: reason" of each failure that these logs say is recorded, once however many steps passed it on."""
    found = (line.removeprefix(RECORDED) for _, line in _lines_since(folder, start_s) if line.startswith(RECORDED))
    return list(dict.fromkeys(found))


def repeat_warnings(folder: Path, start_s: float) -> None:
    """Repeat the warnings and the recorded failures of this run."""
    _print_list("Warnings", warnings_since(folder, start_s), folder)
    failures = failures_since(folder, start_s)
    _print_list("Failures that are recorded in place of results", failures, folder)
    if failures:
        print("  To try one again, delete the file or folder in front of it, or name it after --forcerun.", file=sys.stderr)


def require_finished(targets: Iterable[str]) -> None:
    """Raise StepError where a finished mesh that was asked for is the record of a failure; other files may be records."""
    for target in sorted(targets):
        failure = read_failure(Path(target)) if Path(target).stem == FINISHED else None
        if failure:
            raise StepError(f"{target} could not be made: {failure}. {how_to_try_again(failure.place)}")


def _lines_since(folder: Path, start_s: float) -> Iterator[tuple[Path, str]]:
    """The lines of the logs that were written at `start_s` or later, each with its log."""
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(set(folders) - PICTURES)
        if Path(place).name != "logs":
            continue
        for log in (Path(place) / name for name in sorted(files) if name.endswith(".log")):
            if log.stat().st_mtime >= start_s:
                yield from ((log, line) for line in log.read_text(errors="replace").splitlines())


def _print_list(title: str, lines: list[str], folder: Path) -> None:
    """A title with the number of lines, and the first of them."""
    if lines:
        print(f"\n{title} ({len(lines)}):", file=sys.stderr)
        print(*(f"  {line}" for line in lines[:SHOWN]), sep="\n", file=sys.stderr)
    if len(lines) > SHOWN:
        print(f"  and {len(lines) - SHOWN} more in the logs below {folder}", file=sys.stderr)
