"""Check that the installed wheels load, and name (or, as root, install) the system libraries that they miss.

Wheels bring almost everything; Open3D and PyMeshLab still link a few libraries of the desktop that a bare Debian or
Ubuntu lacks. Their loader names only the first one missing; this names all in one command.
"""

import ctypes
import importlib
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping

from zeroshop_steps.runtime.errors import StepError

# Shared library -> Debian and Ubuntu package. libusb is not here: o3d.py takes it from a wheel.
SYSTEM_PACKAGES = {
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libOpenGL.so.0": "libopengl0",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libgomp.so.1": "libgomp1",
}
MODULES = ("torch", "numba", "cv2", "pycolmap", "OpenEXR", "pymeshlab", "xatlas", "trimesh", "zeroshop_steps.runtime.open3d_loader")


def missing_packages(packages: Mapping[str, str] = SYSTEM_PACKAGES) -> list[str]:
    """Of shared libraries and the system packages that have them, the packages whose libraries cannot be loaded."""
    return [package for library, package in packages.items() if not _loads(library)]


def check_imports() -> None:
    """Import every compiled dependency.

    Raises:
        StepError: a module does not load; names it and the reason.
    """
    for name in MODULES:
        try:
            importlib.import_module(name)
        except (ImportError, OSError) as error:
            raise StepError(f"{name} is installed but does not load: {error}") from error


def install_missing(packages: list[str]) -> None:
    """Install system packages as root, or tell the user the command.

    Raises:
        StepError: not root, no apt-get, or apt-get failed; carries the command.
    """
    command = ["apt-get", "install", "--yes", "--no-install-recommends", *packages]
    remedy = f"system libraries are missing. Run: sudo apt-get update && sudo {' '.join(command)}"
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        raise StepError(remedy)
    print(f"installing missing system libraries: {' '.join(packages)}", file=sys.stderr)
    for step in (["apt-get", "update", "--quiet"], command):
        if subprocess.run(step, check=False, stdout=subprocess.DEVNULL).returncode != 0:
            raise StepError(remedy)


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def main() -> int:
    """Entry point of the Makefile's check; returns the exit status."""
    try:
        packages = missing_packages()
        if packages:
            install_missing(packages)
        check_imports()
    except StepError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
