"""Faults of the machine: missing permissions, names that are too long, memory that runs out."""

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from faults.photos import take_photos
from helpers.faults import Fault, step
from helpers.paths import REPOSITORY, SNAKEFILE
from zeroshop_steps.runtime.files import read_json

PLAIN_USER = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]
"""In front of a command: as root, but bound by the permissions of files like everybody else."""


def run_alone(words: list[object], limits: dict[int, int] | None = None) -> int:
    """Call a step in a process of its own, bound by permissions and with limits; what it says goes to stderr."""

    def prepare() -> None:
        for kind, most in (limits or {}).items():
            resource.setrlimit(kind, (most, most))

    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY / "src"), *sys.path])}
    command = [*(PLAIN_USER if os.geteuid() == 0 else []), sys.executable, "-m", *map(str, words)]
    run = subprocess.run(command, env=environment, preexec_fn=prepare, capture_output=True, text=True, check=False, timeout=120)
    print(run.stderr, run.stdout, file=sys.stderr)
    return run.returncode


def capture_without(spoil: Callable[[Path], object]) -> Callable[[Path], int]:
    """Import photos after `spoil` took permissions away."""

    def run(folder: Path) -> int:
        photos = take_photos(folder)
        spoil(photos)
        try:
            return run_alone(["zeroshop_steps.capture", "--method", "photos", "--images", photos, "--out", folder / "capture"])
        finally:
            for place in (folder, photos):
                place.chmod(0o755)

    return run


def capture_into(out: Callable[[Path], Path]) -> Callable[[Path], int]:
    """Import photos into a folder that cannot be made."""
    return lambda folder: step("capture", "photos", images=take_photos(folder), out=out(folder))


def make_file(folder: Path) -> Path:
    """A file where a folder is needed."""
    (folder / "file").write_text("")
    return folder / "file/capture"


def hide_photo(photos: Path) -> None:
    """Photos of which one may not be read."""
    (photos / "1.jpg").chmod(0)


def read_under_limit(folder: Path) -> int:
    """Register with so little memory that the libraries hardly load."""
    take_photos(folder, 1600, 1200).rename(folder / "images")
    words = ["zeroshop_steps.register", "--method", "colmap", "--capture", folder, "--scene", "video", "--out", folder / "cameras"]
    return run_alone(words, {resource.RLIMIT_AS: 1_500_000_000})


def plan_with_closed_table(folder: Path) -> int:
    """Plan with a table of objects that may not be read."""
    (folder / "objects.tsv").write_text("dataset\tobject\timages\n")
    (folder / "objects.tsv").chmod(0)
    words = ["snakemake", "--snakefile", SNAKEFILE, "--directory", folder, "--cores", 1, "-n", "results/photos/thing/2dgs.ply"]
    return run_alone([*words, "--config", f"objects_table={folder / 'objects.tsv'}"])


PERMISSIONS = [
    Fault(
        "a table that may not be read",
        plan_with_closed_table,
        (r"objects\.tsv cannot be read: Permission denied", "objects_table", "ls -ld"),
    ),
    Fault(
        "a photo that may not be read",
        capture_without(lambda photos: (photos / "1.jpg").chmod(0)),
        (r"1\.jpg.*Permission denied", "ls -ld"),
    ),
    Fault("a folder that may not be read", capture_without(lambda photos: photos.chmod(0o311)), ("photos.*Permission denied", "ls -ld")),
    Fault(
        "a parent that may not be written to",
        capture_without(lambda photos: photos.parent.chmod(0o555)),
        ("cannot write .*capture: Permission denied", "ls -ld"),
    ),
]
FAULTS = [
    *(PERMISSIONS if os.geteuid() or shutil.which("setpriv") else []),
    Fault(
        "a name of 300 letters", capture_into(lambda folder: folder / ("n" * 300)), ("cannot write .*File name too long", "shorter names")
    ),
    Fault(
        "a parent that is a file",
        capture_into(lambda folder: make_file(folder)),
        ("cannot write .*capture", "a file, not a folder|File exists"),
    ),
    Fault("a record that is a folder", lambda folder: read_json(folder), ("cannot be read: Is a directory", "not a folder")),
    Fault("little memory", read_under_limit, ("the features of 8 images need 1500 MB of memory", "ulimit -v", "raise it")),
]
