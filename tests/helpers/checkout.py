"""A second checkout of the project, for tests that change its files or share results with it."""

import os
import shutil
from pathlib import Path

from numba.core.caching import UserProvidedCacheLocator

from helpers.paths import REPOSITORY

KERNELS = "NUMBA_CACHE_DIR"


def copy_checkout(folder: Path) -> dict[str, str]:
    """Copy what runs into a folder, with the kernels that were compiled here; the environment in which the copy runs.

    Numba finds kernels by the path of their source, so that the copy, whose sources are the same, would compile all of them again.
    """
    for part in ("workflow", "config", "src"):
        shutil.copytree(REPOSITORY / part, folder / part, ignore=shutil.ignore_patterns("*.egg-info"))
    environment = {**os.environ, "PYTHONPATH": str(folder / "src")}
    if KERNELS in os.environ:  # without it, they lie beside the sources
        environment[KERNELS] = str(folder / "kernels")
        for package in {path.parent for path in (folder / "src").rglob("*.py")}:
            here = Path(os.environ[KERNELS], folder_of_kernels(REPOSITORY / package.relative_to(folder)))
            if here.is_dir():
                shutil.copytree(here, folder / "kernels" / folder_of_kernels(package))
    return environment


def folder_of_kernels(package: Path) -> str:
    """The name that Numba gives the folder of a package's kernels."""
    return UserProvidedCacheLocator.get_suitable_cache_subpath(str(package / "any.py"))
