"""Free Snakemake's lock on a folder where the run that held it is dead: the computer was switched off, or the run was killed.

Snakemake's lock does not say who holds it, so each run leaves a note of its process and its machine beside it. Where there is no note, or
its process may still run, the lock stays.
"""

import os
import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path

from zeroshop_steps.runtime.files import read_json, write_json

NOTE = ".snakemake/zeroshop_run.json"
LOCKS = ".snakemake/locks"


def note_run(folder: Path, process: int) -> None:
    """Write down which process of this machine runs Snakemake in a folder."""
    (folder / NOTE).parent.mkdir(parents=True, exist_ok=True)
    write_json(folder / NOTE, {"machine": platform.node(), "process": process})


def free_dead_lock(folder: Path, command: Sequence[str]) -> bool:
    """Unlock a folder by Snakemake's `command` if the run that was noted there is dead; whether that was done."""
    if not (folder / NOTE).is_file() or not any((folder / LOCKS).glob("*.lock")):
        return False
    note = read_json(folder / NOTE)
    if note["machine"] != platform.node() or _may_run(note["process"]):
        return False
    subprocess.run([*command, "--unlock"], check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return True


def _may_run(process: int) -> bool:
    """Whether there is a process of this number; another one may have got it since."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass  # it is another user's
    return True
