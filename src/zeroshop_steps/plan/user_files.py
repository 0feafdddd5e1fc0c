"""The files in the user's folders: those that Snakemake can take as inputs."""

import time
from collections.abc import Iterable
from pathlib import Path

from zeroshop_steps.geometry.imaging.image_files import is_text
from zeroshop_steps.runtime.errors import StepError, remedy_for

CLOCK_TOLERANCE_S = 5
"""Clocks of file servers differ by a second or two; a capture takes longer."""


def has_plain_name(path: Path) -> bool:
    """Whether Snakemake can name a file: it takes braces for wildcards, and fails at names that are not UTF-8."""
    return is_text(str(path)) and not set("{}") & set(str(path))


def list_visible(folder: Path) -> list[Path]:
    """The files in one of the user's folders, without hidden ones."""
    try:
        return [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]
    except OSError as error:
        raise StepError(f"the folder {folder} cannot be read: {error.strerror}. {remedy_for(error)}") from None


def require_past(files: Iterable[Path], words: str) -> None:
    """Raise StepError where a file was changed in the future: Snakemake would discard what is made from it as older.

    Args:
        files: those to look at.
        words: by which a shell names all of them.
    """
    ahead = [path for path in files if path.stat().st_mtime > time.time() + CLOCK_TOLERANCE_S]
    if ahead:
        changed = time.strftime("%Y-%m-%d %H:%M", time.localtime(ahead[0].stat().st_mtime))
        raise StepError(
            f"{len(ahead)} of the user's files are from the future, such as {ahead[0]} ({changed}): the clock of this machine or of the"
            f" camera is wrong. Set it right, or give the files the present time: touch {words}"
        )
