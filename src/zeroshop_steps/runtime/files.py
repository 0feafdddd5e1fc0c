"""Writing files so that a product is either whole or absent: write beside, then rename."""

import contextlib
import errno
import fcntl
import json
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from zeroshop_steps.runtime.errors import StepError, remedy_for
from zeroshop_steps.runtime.temporary import PART, temporary_file, temporary_folder

GIT_LFS_POINTER = b"version https://git-lfs"  # the first bytes of what Git leaves in place of a large file


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` when the block ends, delete it when the block fails.

    The temporary name keeps the suffix, because image and mesh writers choose the format by it. What is written is on the disk
    before it gets its name. Write through Python's files: many writers in C++ report success on a full disk.

    Raises:
        StepError: the disk is full, permission is missing and the like, with the remedy.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_file(path) as temporary:
            yield temporary
            if not _in_temporary_folder(path):
                _sync(temporary)
            os.replace(temporary, path)
    except OSError as error:
        raise _not_written(path, error) from error


@contextlib.contextmanager
def atomic_directory(path: Path) -> Iterator[Path]:
    """Yield a temporary directory beside `path` that replaces `path` when the block ends and vanishes when it fails."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(path.parent, path.name) as temporary:
            yield temporary
            temporary.chmod(0o755)
            with ThreadPoolExecutor(8) as pool:
                for _ in pool.map(_sync, (file for file in temporary.rglob("*") if file.is_file() and not file.is_symlink())):
                    pass
            _replace_folder(temporary, path)
    except OSError as error:
        raise _not_written(path, error) from error


def _replace_folder(temporary: Path, path: Path) -> None:
    """Give a folder its name; an older one is moved away first, so that a process that is killed here leaves no half of it."""
    while True:
        try:
            if path.is_dir() and not path.is_symlink():
                with temporary_folder(path.parent, path.name) as former, contextlib.suppress(FileNotFoundError):
                    os.replace(path, former)
            else:
                path.unlink(missing_ok=True)
            os.replace(temporary, path)
            return
        except OSError as error:
            # Another process, such as an orphaned one of the same step, has put its own there meanwhile.
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.EISDIR, errno.ENOTDIR):
                raise


@contextlib.contextmanager
def scratch_directory(product: Path, name: str) -> Iterator[Path]:
    """Yield a folder for intermediate files beside `product`, which vanishes at the end.

    Args:
        product: the file or folder that is made by means of it.
        name: of what it holds.
    """
    with temporary_folder(Path(product).parent, name) as folder:
        yield folder


def _sync(path: Path) -> None:
    """Wait until a file is on the disk: some file systems find out only then that they are full."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _in_temporary_folder(path: Path) -> bool:
    """Whether a file is part of a folder that is not yet in its place, and is synced with it."""
    return any(parent.name.startswith(".") and parent.name.endswith(PART) for parent in path.parents)


def _not_written(path: Path, error: OSError) -> StepError:
    """Why a product was not written; where another file is at fault, such as one it is made from, its name."""
    reason, own = error.strerror or error, error.filename is None or _is_own(Path(os.fsdecode(error.filename)), path)
    if not own and isinstance(error, FileNotFoundError):
        return StepError(f"{error.filename} does not exist, and {path} is made from it; check the path, or run the step that writes it")
    if not own:
        reason = f"{reason}: {error.filename}"
    return StepError(f"cannot write {path}: {reason}. {remedy_for(error) if own else f'Check that file: {remedy_for(error)}'}")


def _is_own(name: Path, path: Path) -> bool:
    """Whether an error names the product, a folder above it, or its temporary."""
    return name == path or name in path.parents or path in name.parents or any(part.startswith(".") and PART in part for part in name.parts)


def link_or_copy(source: Path | str, target: Path | str) -> None:
    """Link a file to another name, or copy it where the file system has no links."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def write_json(path: Path, content: Any) -> None:
    """Write `content` as indented JSON; NaN and infinities are refused, they are no JSON."""
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")


class Record(dict[str, Any]):
    """The JSON object in a file; a key that it lacks is an error that names the file."""

    def __init__(self, path: Path, content: dict[str, Any]) -> None:
        super().__init__(content)
        self.path = path

    def __missing__(self, key: str) -> Any:
        raise StepError(f"{self.path} has no {key}: it is damaged or of another version; delete it and run its step again")


def read_json(path: Path) -> Record:
    """Read the record that a step wrote.

    Raises:
        StepError: names the file, which is missing or damaged; also later, where a key is read that the record lacks.
    """
    content = read_json_value(path)
    if not isinstance(content, dict):
        raise StepError(f"{path} holds no JSON object, but a {type(content).__name__}; delete it and run its step again")
    return Record(path, content)


def read_json_value(path: Path) -> Any:
    """Read any JSON, with an error that names the file."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise StepError(f"{path} does not exist; check the path, or run the step that writes it") from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise StepError(
            f"{path} is not valid JSON ({error}); it is damaged or of another format: write it again, or run its step again"
        ) from None
    except RecursionError:
        raise StepError(f"{path} is nested deeper than any record; delete it and run its step again") from None
    except OSError as error:
        raise StepError(f"{path} cannot be read: {error.strerror}. {remedy_for(error)}") from error


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock file, so that parallel steps do not write the same file."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = open(path, "w")  # noqa: SIM115
    except OSError as error:
        raise StepError(f"cannot write {path}: {error.strerror}. Check free disk space and permissions.") from error
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
