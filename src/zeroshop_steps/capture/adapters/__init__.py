"""Adapters of what labs have already: one file each, which declares an ADAPTER and nothing else lists it.

Each recognizes a folder or file, and reads it as frames with lenses, poses, masks and depth (`form.py`), which are written in the
common form (`../cameras_json.py`): images/, masks/, depth/ and cameras.json.
"""

import functools
import importlib
import pkgutil
from pathlib import Path

from zeroshop_steps.capture.adapters import board_photos
from zeroshop_steps.capture.adapters.form import Adapter

OTHERS = ("a folder of photos", "a film", "the common form: cameras.json beside images/ (docs/given-cameras.md)")
"""What is known without an adapter."""


@functools.cache
def find_adapters() -> tuple[Adapter, ...]:
    """All adapters, by rank."""
    modules = (importlib.import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__))
    return tuple(sorted((module.ADAPTER for module in modules if hasattr(module, "ADAPTER")), key=lambda one: (one.rank, one.title)))


def recognize(path: Path, board: str | None = None) -> Adapter | None:
    """The adapter that knows a folder or file, or that of photos with a board; None where none does."""
    if board is not None:
        return board_photos.ADAPTER
    return next((adapter for adapter in find_adapters() if adapter.recognizes(path)), None)


def list_known() -> str:
    """What can be given, in words."""
    return "; ".join([*OTHERS, *(f"{adapter.title} ({adapter.expects})" for adapter in find_adapters())])
