"""Free Snakemake's lock on a folder where the run that held it is dead: the computer was switched off, or the run was killed.

Snakemake's lock does not say who holds it, so each run leaves a note of its process, of when that began, and of its machine beside it,
until it ends. Where there is no note, or its process or another Snakemake may still run there, the lock stays.
"""

import platform
import shutil
from pathlib import Path

import psutil

from zeroshop_steps.runtime.files import read_json, write_json

NOTE = ".snakemake/zeroshop_run.json"
LOCKS = ".snakemake/locks"


def note_run(folder: Path, process: int) -> None:
    """Write down which process of this machine runs Snakemake in a folder, unless another run holds its lock."""
    if any((folder / LOCKS).glob("*.lock")):
        return
    (folder / NOTE).parent.mkdir(parents=True, exist_ok=True)
    write_json(folder / NOTE, {"machine": platform.node(), "process": process, "began_s": _find_start_s(process)})


def remove_note(folder: Path, process: int) -> None:
    """Remove the note of a process that ended, and with it its lock: a later lock is another run's."""
    if (folder / NOTE).is_file() and read_json(folder / NOTE)["process"] == process:
        (folder / NOTE).unlink()


def free_dead_lock(folder: Path) -> bool:
    """Unlock a folder, as Snakemake's `--unlock` does, if the run that was noted there is dead; whether that was done."""
    if not (folder / NOTE).is_file() or not any((folder / LOCKS).glob("*.lock")):
        return False
    note = read_json(folder / NOTE)
    if note["machine"] != platform.node() or _may_run(note["process"], note.get("began_s")) or _is_in_use(folder):
        return False
    shutil.rmtree(folder / LOCKS)
    return True


def describe_holder(folder: Path) -> str:
    """Who left the last note in a folder, in words that follow its name; empty without any."""
    note = read_json(folder / NOTE) if (folder / NOTE).is_file() else {}
    return f", by its note process {note['process']} of the machine {note['machine']}" if note else ""


def _may_run(process: int, began_s: float | None) -> bool:
    """Whether there is a process of this number that began then; after a restart of the machine, another one has it soon."""
    now_s = _find_start_s(process)
    # Clocks may be set between two readings of when a process began.
    return now_s is not None and (began_s is None or abs(now_s - began_s) < 2.0)


def _find_start_s(process: int) -> float | None:
    """When a process began, in seconds as clocks have it; None where there is none of this number, or only its remains."""
    try:
        found = psutil.Process(process)
        return None if found.status() == psutil.STATUS_ZOMBIE else float(found.create_time())
    except psutil.NoSuchProcess:
        return None


def _is_in_use(folder: Path) -> bool:
    """Whether a Snakemake of this machine works in a folder: one that the user called, too, which leaves no note."""
    for process in psutil.process_iter(["cmdline", "cwd"]):
        command, place = process.info["cmdline"] or [], process.info["cwd"]
        if place and any(Path(word).name == "snakemake" for word in command[:3]) and Path(place) == folder.resolve():
            return True
    return False
