"""A step runs in a child process, and its parent says why that ended where it cannot do so itself.

Where memory or the disk runs out in a thread of a library in C++, such as COLMAP, the library ends the whole process; and the kernel
kills a process that takes too much memory. The parent is made before any library is loaded, so it takes 20 MB and no time.
"""

import ctypes
import os
import resource
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from zeroshop_steps.runtime.errors import REMEDY_FOR_ROOM, describe_memory
from zeroshop_steps.runtime.temporary import remove_abandoned

FULL_BYTES = 4_000_000
"""A disk with less is called full: what did not fit is not on it, and COLMAP writes up to 2 MB of an image's features at once."""


def wait_for_child(out: Path | None) -> int | None:
    """Go on in a child process. Returns None there, and its exit status in this process, once it has ended.

    A child that did not end by itself is explained on stderr, and its temporary files are removed; the status is 1.

    Args:
        out: what the step writes.
    """
    parent = os.getpid()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        # PR_SET_PDEATHSIG of Linux is 1.
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)
        if os.getppid() != parent:  # it has died meanwhile
            os._exit(1)
        return None
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the child gets it, too, from the terminal or from Snakemake
    signal.signal(signal.SIGTERM, lambda number, frame: os.kill(child, number))
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code >= 0:
        return code
    places = [_existing(out.absolute().parent)] if out else []
    print(f"error: {explain_end(-code, [*places, Path(tempfile.gettempdir())])}", file=sys.stderr)
    for place in places:
        remove_abandoned(place)
    return 1


def explain_end(number: int, places: Iterable[Path]) -> str:
    """Why a step was ended by a signal, with the remedy.

    Args:
        number: of the signal.
        places: folders to whose disks it wrote.
    """
    free_bytes = {place: shutil.disk_usage(place).free for place in places}
    full = [f"{place} ({free / 1e6:.1f} MB free)" for place, free in free_bytes.items() if free < FULL_BYTES]
    if full and number != signal.SIGKILL:
        return f"the disk of {' and of '.join(full)} is full, and a library ended the step. {REMEDY_FOR_ROOM}"
    how = "killed" if number == signal.SIGKILL else f"ended by a library ({signal.Signals(number).name}; see above for its words)"
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    causes = ["memory ran out", *([f"a file reached {limit / 1e6:.1f} MB (ulimit -f)"] if limit != resource.RLIM_INFINITY else [])]
    return f"the step was {how}, most often because {' or '.join(causes)}: {describe_memory()}"


def _existing(folder: Path) -> Path:
    return next(place for place in (folder, *folder.parents) if place.is_dir())
