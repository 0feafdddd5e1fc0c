"""Import a script of the folder of benchmarks, which are no package."""

import importlib
import sys
from collections.abc import Iterator
from types import ModuleType

from helpers.paths import REPOSITORY


def load_script(name: str) -> Iterator[ModuleType]:
    """The script, while its neighbours can be imported too; for a fixture to yield from."""
    sys.path.insert(0, str(REPOSITORY / "benchmarks"))
    try:
        yield importlib.import_module(name)
    finally:
        sys.path.remove(str(REPOSITORY / "benchmarks"))
