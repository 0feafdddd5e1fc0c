"""Writing files so that a product is either whole or absent: write beside, then rename."""

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from zeroshop_steps.runtime.errors import StepError


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` when the block ends, delete it when the block fails.

    The temporary name keeps the suffix, because image and mesh writers choose the format by it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise _not_written(path, temporary, error) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_directory(path: Path) -> Iterator[Path]:
    """Yield a temporary directory beside `path` that replaces `path` when the block ends and vanishes when it fails."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
    try:
        yield temporary
        temporary.chmod(0o755)
        if path.exists():
            shutil.rmtree(path)
        os.replace(temporary, path)
    except OSError as error:
        raise _not_written(path, temporary, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _not_written(path: Path, temporary: Path, error: OSError) -> StepError:
    """Why a product was not written; where another file is at fault, such as one it is made from, its name."""
    reason, remedy = error.strerror or error, "Check free disk space and permissions."
    if error.filename is not None and not str(error.filename).startswith((str(temporary), str(path))):
        reason, remedy = f"{reason}: {error.filename}", "Check that file, free disk space and permissions."
    return StepError(f"cannot write {path}: {reason}. {remedy}")


def write_json(path: Path, content: Any) -> None:
    """Write `content` as indented JSON; NaN and infinities are refused, they are no JSON."""
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """Read JSON, with an error that names the file."""
    try:
        return json.loads(Path(path).read_text())
    except FileNotFoundError:
        raise StepError(f"{path} does not exist; run the step that writes it first") from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise StepError(f"{path} is not valid JSON ({error}); delete it and run its step again") from None
