"""The end of a fork of a process that has imported much."""

import atexit
import os
import sys
import threading
import traceback
from collections.abc import Callable
from typing import NoReturn


def run_and_end(run: Callable[[], object]) -> NoReturn:
    """Call a function and end this process as Python does, with what it returns as the status.

    But nothing is cleared away object by object: the fork would first copy all that it shares, half a second for nothing.
    """
    try:
        try:
            sys.exit(run())
        finally:
            threading._shutdown()
            atexit._run_exitfuncs()
    except SystemExit as ended:
        status = ended.code
    except BaseException:
        traceback.print_exc()
        status = 1
    if isinstance(status, str):
        print(status, file=sys.stderr)
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(int(status or 0))
