"""Temporary files and folders beside the products that they become, each locked by the process that writes it.

The kernel releases the lock when that process ends, however it ends: what no living process holds was left by one that was killed,
and the next writer of the same product removes it. Locks rather than process numbers, because another machine may share the folder.
"""

import contextlib
import fcntl
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

PART = ".part"
TEMPORARY = re.compile(rf"\..*\.[0-9a-f]{{8}}{re.escape(PART)}(\..*)?", re.DOTALL)
NAME_BYTES = 100
"""Of a product's name in that of its temporary: file systems end at 255 bytes for all of it."""


@contextlib.contextmanager
def temporary_file(path: Path) -> Iterator[Path]:
    """Yield an empty file beside `path` with the same suffix, which writers choose the format by; remove what is left of it."""
    start, suffix = _start_of(path.stem), path.suffix if len(os.fsencode(path.suffix)) <= NAME_BYTES else ""
    with _claimed(path.parent, start, PART + suffix, folder=False) as temporary:
        yield temporary


@contextlib.contextmanager
def temporary_folder(parent: Path, name: str) -> Iterator[Path]:
    """Yield an empty folder in `parent` for the product `name`; remove what is left of it."""
    with _claimed(parent, _start_of(name), PART, folder=True) as temporary:
        yield temporary


def _start_of(name: str) -> str:
    return f".{os.fsdecode(os.fsencode(name)[:NAME_BYTES])}."


@contextlib.contextmanager
def _claimed(parent: Path, start: str, end: str, folder: bool) -> Iterator[Path]:
    _sweep(parent, start, end)
    while True:
        path = parent / f"{start}{secrets.token_hex(4)}{end}"
        if folder:
            path.mkdir()
        # Until it is locked, another process may sweep it.
        with contextlib.suppress(FileNotFoundError):
            lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY) if folder else os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
            if _holds(lock, path):
                break
            os.close(lock)
    try:
        yield path
    finally:
        _remove(path)
        os.close(lock)


def _sweep(parent: Path, start: str, end: str) -> None:
    """Remove what writers of the same product left when they were killed."""
    with contextlib.suppress(OSError):
        left = [entry.name for entry in os.scandir(parent) if entry.name.startswith(start) and entry.name.endswith(end)]
        for path in (parent / name for name in left):
            with contextlib.suppress(OSError):
                lock = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    _remove(path)
                finally:
                    os.close(lock)


def remove_abandoned(folder: Path) -> None:
    """Remove every temporary file and folder in `folder` that no living process holds."""
    with contextlib.suppress(OSError):
        for name in [entry.name for entry in os.scandir(folder) if TEMPORARY.fullmatch(entry.name)]:
            _sweep(folder, name, "")


def _holds(lock: int, path: Path) -> bool:
    """Whether the lock was taken on what `path` still names; true as well on file systems without locks, where nothing is swept."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    try:
        return os.path.samestat(os.fstat(lock), os.stat(path))
    except FileNotFoundError:
        return False


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
