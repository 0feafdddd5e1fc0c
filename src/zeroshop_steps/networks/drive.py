"""Files that lie in a folder of Google Drive or alone there, by gdown, which knows how Drive asks before it hands out large files."""

import importlib
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from zeroshop_steps.runtime.downloads import verify
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import locked

PAGES = {"drive": "https://drive.google.com/file/d/{}/view", "drive-folder": "https://drive.google.com/drive/folders/{}"}


@dataclass(frozen=True)
class DriveFile:
    """A file of Google Drive.

    Attributes:
        kind: of PAGES: a file, or the folder that has it.
        number: of the file or folder, as Drive's addresses have it.
    """

    kind: str
    number: str

    @staticmethod
    def parse(url: str) -> "DriveFile | None":
        """From `drive:NUMBER` or `drive-folder:NUMBER`; None for another URL."""
        kind, _, number = url.partition(":")
        return DriveFile(kind, number) if kind in PAGES else None

    def __str__(self) -> str:
        return PAGES[self.kind].format(self.number)


def take_from_drive(file: DriveFile, path: Path, without: str, sha256: str | None = None) -> None:
    """Download a file to `path`, continuing what an earlier call has of it, and verify it as `downloads.download` does.

    Args:
        file: which one; in a folder, the one whose own path ends as `path` does.
        path: where it belongs.
        without: what a user can do instead, for the error message.
        sha256: what it must have, where that is known.

    Raises:
        StepError: gdown is not installed, Drive refuses, the folder has no such file, or the bytes are others.
    """
    gdown = _import_gdown(file, path)
    part = path.with_name(path.name + ".part")
    with locked(path.with_name(path.name + ".lock")):
        if not path.is_file():
            try:
                number = file.number if file.kind == "drive" else _find_in_folder(gdown, file, path)
                found = gdown.download(id=number, output=str(part), resume=True)
            except StepError:
                raise
            except Exception as error:  # gdown's own, requests' and urllib's
                raise StepError(f"cannot download {file} ({error}). {_by_hand(file, path)}; or {without}") from error
            if not found or not part.is_file():
                raise StepError(f"Google Drive refused {file}, most often because too many people asked for it. {_by_hand(file, path)}")
            part.rename(path)
        verify(path, sha256)


def _import_gdown(file: DriveFile, path: Path) -> ModuleType:
    try:
        return importlib.import_module("gdown")
    except ImportError:
        raise StepError(f"{path.name} lies in Google Drive, which needs gdown: pip install gdown. {_by_hand(file, path)}") from None


def _find_in_folder(gdown: ModuleType, file: DriveFile, path: Path) -> str:
    ending = "/".join(path.parts[-2:])
    listed = gdown.download_folder(id=file.number, skip_download=True, quiet=True) or []
    for one in listed:
        if str(one.path).endswith(ending):
            return str(one.id)
    raise StepError(f"{file} has no {ending}, but {', '.join(str(one.path) for one in listed) or 'nothing'}. {_by_hand(file, path)}")


def _by_hand(file: DriveFile, path: Path) -> str:
    return f"By hand: take {'/'.join(path.parts[-2:])} from {file} and put it at {path}"
