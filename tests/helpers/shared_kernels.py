"""Compiled kernels that the processes of a test run take from one another, so that most are compiled once."""

import contextlib
import os
import pickle
import time
from itertools import count
from pathlib import Path
from typing import Any

SETTLED_S = 2.0
"""Numba writes the index of a function before its code. An index of this age has all its code beside it."""
_taken: dict[Path, float] = {}


def take_kernels(everyone: Path, own: Path) -> None:
    """Add to a process's kernels those that the others have compiled and it has not.

    Two processes that write into one index may mix up the signatures of a function. So each has a folder of its own, reads those of the
    others, and calls this only while nothing writes into its own.

    Args:
        everyone: the folder that holds a folder for each process.
        own: that of this process.
    """
    for index in sorted(everyone.glob("*/*/*.nbi")):
        written_s = index.stat().st_mtime
        if index.parents[1] != own and _taken.get(index) != written_s and time.time() - written_s > SETTLED_S:
            with contextlib.suppress(ModuleNotFoundError):  # types of a module that has moved since
                _take(index, own / index.parent.name)
            _taken[index] = written_s


def _take(index: Path, folder: Path) -> None:
    """Add the kernels of a function: numba's index has a version, and then the stamp of the source and the code's file by signature."""
    version, stamp, kernels = _read(index)
    own = folder / index.name
    own_version, own_stamp, known = _read(own) if own.exists() else (version, stamp, {})
    if (own_version, own_stamp) != (version, stamp):
        if own_stamp > stamp:  # made from a newer source
            return
        known = {}
    folder.mkdir(parents=True, exist_ok=True)
    missing = {signature: name for signature, name in kernels.items() if signature not in known}
    for signature, name in missing.items():
        if (index.parent / name).exists():
            free = next(one for number in count(1) if (one := f"{index.stem}.{number}.nbc") not in known.values())
            _replace(folder / free, (index.parent / name).read_bytes())
            known[signature] = free
    if missing:
        _replace(own, pickle.dumps(version, protocol=-1) + pickle.dumps((stamp, known)))


def _read(index: Path) -> tuple[str, Any, dict[Any, str]]:
    with index.open("rb") as file:
        return pickle.load(file), *pickle.loads(file.read())


def _replace(path: Path, content: bytes) -> None:
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    part.write_bytes(content)
    part.replace(path)
