"""What steps warned of during a run of the workflow, repeated at its end: nobody opens the log of a step that succeeded."""

import os
import sys
from pathlib import Path

from zeroshop_steps.runtime.errors import WARNING

SHOWN = 30
PICTURES = {"images", "masks", "depth", "truth"}
"""Folders with many files and no logs."""


def warnings_since(folder: Path, start_s: float) -> list[str]:
    """ "LOG: warning" of each line in the logs below `folder` that were written at `start_s` (seconds since the epoch) or later."""
    found = []
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(set(folders) - PICTURES)
        if Path(place).name != "logs":
            continue
        for log in (Path(place) / name for name in sorted(files) if name.endswith(".log")):
            if log.stat().st_mtime >= start_s:
                lines = log.read_text(errors="replace").splitlines()
                found += [f"{log}: {line.removeprefix(WARNING)}" for line in lines if line.startswith(WARNING)]
    return found


def repeat_warnings(folder: Path, start_s: float) -> None:
    """Repeat the warnings of this run."""
    found = warnings_since(folder, start_s)
    if found:
        print(f"\nWarnings ({len(found)}):", file=sys.stderr)
        print(*(f"  {line}" for line in found[:SHOWN]), sep="\n", file=sys.stderr)
        if len(found) > SHOWN:
            print(f"  and {len(found) - SHOWN} more in the logs below {folder}", file=sys.stderr)
