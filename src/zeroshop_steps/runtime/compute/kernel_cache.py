"""A place for compiled kernels: Numba stops at the import of a kernel where it finds none that it may write to."""

import os
import tempfile
from pathlib import Path

from zeroshop_steps.runtime.errors import warn

VARIABLE = "NUMBA_CACHE_DIR"
PACKAGE = Path(__file__).parents[2]


def provide_kernel_cache() -> None:
    """Let Numba use a folder of this user's in the temporary folder where it would find no other. To be called before Numba is imported.

    Numba looks at the folder that NUMBA_CACHE_DIR names, beside the sources, and in the user's cache.
    """
    usual = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"
    given = os.environ.get(VARIABLE)
    if any(_can_write(folder) for folder in (*([Path(given)] if given else []), PACKAGE, usual)):
        return
    folder = Path(tempfile.gettempdir()) / f"zeroshop-kernels-{os.geteuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.stat().st_uid != os.geteuid() or folder.stat().st_mode & 0o077:
        # Somebody else made it: compiled code from there is not to be trusted.
        folder = Path(tempfile.mkdtemp(prefix="zeroshop-kernels-"))
    os.environ[VARIABLE] = str(folder)
    warn(
        f"compiled kernels are kept in {folder}, since {given or PACKAGE} and {usual} cannot be written to; {VARIABLE} names another place"
    )


def _can_write(folder: Path) -> bool:
    """Whether files can be made in a folder, or in the first folder above it that exists."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
