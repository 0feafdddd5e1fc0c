"""The rooms of the package lie along the way of the data: none imports one that comes later."""

import ast
from pathlib import Path

import zeroshop_steps

SOURCES = Path(zeroshop_steps.__file__).parent
ROOMS = [
    "runtime",
    "geometry",
    "networks",
    "methods",
    "config_manual",
    "bop",
    "synthetic",
    "capture",
    "register",
    "segment",
    "join",
    "surface",
    "height",
    "finish",
    "evaluate",
    "assets",
    "grasp",
    "detect",
    "pose",
    "robot",
    "simulate",
    "report",
    "app",
]
"""In the order of the way of the data. `bop` holds the benchmark's formats and scores, which rendered test scenes are written in."""


def imported_rooms(path: Path) -> set[str]:
    """The rooms that a source file imports, inside functions, too."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    own = (name.split(".") for name in names if name.startswith("zeroshop_steps."))
    return {parts[1] for parts in own if parts[1] in ROOMS}


def test_every_room_has_its_place() -> None:
    found = {path.name for path in SOURCES.iterdir() if (path / "__init__.py").exists()}
    assert found == set(ROOMS) - {"methods", "config_manual"}


def test_no_import_runs_backwards() -> None:
    backwards = []
    for path in SOURCES.rglob("*.py"):
        room = path.relative_to(SOURCES).parts[0].removesuffix(".py")
        if room in ROOMS:
            later = [name for name in imported_rooms(path) if ROOMS.index(name) > ROOMS.index(room)]
            backwards += [f"{path.relative_to(SOURCES)} imports {name}" for name in later]
    assert not backwards
