"""Start BlenderProc 2.8 on Blender's Python module, in place of the Blender program that it would download.

BlenderProc expects to be started by Blender: it reads Blender's command line, installs packages into Blender's folder with
pip, takes its own folder off the module path, and sets a language that the module lacks. Here it is told what it needs to
know instead; nothing installed is changed.
"""

import importlib.machinery
import importlib.util
import os
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

BPY_VERSION, BLENDERPROC_VERSION = "4.2.23", "2.8.0"
SETUP_MODULE = "blenderproc.python.utility.SetupUtility"
INITIALIZER_MODULE = "blenderproc.python.utility.Initializer"
LANGUAGE = "en_US"


class _SetupWithoutPip:
    """Finds BlenderProc's set-up module, and replaces its installer when it has been executed."""

    def __init__(self, packages: str) -> None:
        self._packages = packages

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        if name != SETUP_MODULE:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path)
        loader = spec.loader if spec else None
        if loader is None:
            return spec
        execute = loader.exec_module

        def exec_module(module: ModuleType) -> None:
            execute(module)
            module.SetupUtility.setup_pip = staticmethod(lambda *_, **__: self._packages)

        vars(loader).update(exec_module=exec_module)
        return spec


class _Overlay:
    """Another object with some attributes replaced."""

    def __init__(self, under: Any, **replaced: Any) -> None:
        self.__dict__.update(_under=under, **replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._under, name)


def start(scratch: Path) -> ModuleType:
    """Import and initialize BlenderProc, its temporary files in `scratch`, and return it.

    Raises:
        ImportError: bpy or BlenderProc is missing or of another version, or a system library that bpy needs is missing.
    """
    import bpy

    found = bpy.app.version_string.split()[0]
    if found != BPY_VERSION:
        raise ImportError(f"bpy has version {found}, expected {BPY_VERSION}")
    spec = importlib.util.find_spec("blenderproc")
    if spec is None or spec.origin is None:
        raise ImportError("No module named 'blenderproc'")
    packages = str(Path(spec.origin).parents[1])
    sys.path.append(packages)  # BlenderProc removes the first mention
    sys.meta_path.insert(0, _SetupWithoutPip(packages))
    os.environ["INSIDE_OF_THE_INTERNAL_BLENDER_PYTHON_ENVIRONMENT"] = "1"
    sys.argv = ["blender", "--background", "--", "script", str(scratch)]
    import blenderproc

    if blenderproc.__version__ != BLENDERPROC_VERSION:
        raise ImportError(f"blenderproc has version {blenderproc.__version__}, expected {BLENDERPROC_VERSION}")
    preferences = _Overlay(bpy.context.preferences, view=SimpleNamespace(language=LANGUAGE))
    vars(sys.modules[INITIALIZER_MODULE]).update(bpy=_Overlay(bpy, context=_Overlay(bpy.context, preferences=preferences)))
    blenderproc.init()
    return blenderproc


def tell(kind: str, text: object = "") -> None:
    """A line for the process that started this one, which tells it from all that Blender prints by its first character."""
    print(f"\n@{kind} {text}".rstrip(), flush=True)


def run(work: Callable[[ModuleType], None]) -> None:
    """Start BlenderProc, do the work and end the process: told are `@ready` at the end, or `@fault` and why it did not start.

    Taking Blender's module down the usual way ends in a segmentation fault, so this does not return.
    """
    status = 1
    with tempfile.TemporaryDirectory() as scratch:
        try:
            bproc = start(Path(scratch))
            work(bproc)
            tell("ready")
            status = 0
        except ImportError as error:
            tell("fault", error)
        except BaseException:
            traceback.print_exc()
    sys.stderr.flush()
    os._exit(status)
