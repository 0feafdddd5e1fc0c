"""The rooms of the package lie along the way of the data: none imports one that comes later."""

import ast
from pathlib import Path

import pytest

import zeroshop_steps

SOURCES = Path(zeroshop_steps.__file__).parent
ROOMS = [
    "runtime",
    "geometry",
    "ros",
    "networks",
    "methods",
    "config_manual",
    "bop",
    "synthetic",
    "capture",
    "scan",
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
    "plan",
    "app",
]
"""In the order of the way of the data. `bop` holds the benchmark's formats and scores, which rendered test scenes are written in."""

ROOMS_INSIDE = {
    "geometry": ["imaging", "cameras", "meshes", "rendering", "alignment", "observation", "support", "boards"],
    "register": ["scene", "features", "matching", "mapping", "silhouettes", "photometry", "refinement", "submodels", "verification"],
    "surface": ["rendering", "mvs", "training", "meshing"],
}
"""The rooms inside a room, in their order; methods, and what only they use, lie beside them and may import all."""
MOST_MODULES = 16
"""Of one folder, without __init__.py and __main__.py."""


def imported_rooms(path: Path) -> set[str]:
    """The rooms that a source file imports, inside functions, too."""
    return {parts[1] for parts in imported_names(path) if parts[1] in ROOMS}


def imported_names(path: Path) -> list[list[str]]:
    """The names of this package that a source file imports, in their parts."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return [name.split(".") for name in names if name.startswith("zeroshop_steps.")]


def test_every_room_has_its_place() -> None:
    found = {path.name for path in SOURCES.iterdir() if (path / "__init__.py").exists()}
    assert found == set(ROOMS) - {"methods", "config_manual"}


def test_no_folder_is_crowded() -> None:
    folders = {path.parent for path in SOURCES.rglob("*.py")}
    modules = {folder: [path for path in folder.glob("*.py") if not path.stem.startswith("__")] for folder in folders}
    assert not {str(folder): len(found) for folder, found in modules.items() if len(found) > MOST_MODULES}


def test_no_import_runs_backwards() -> None:
    backwards = []
    for path in SOURCES.rglob("*.py"):
        room = path.relative_to(SOURCES).parts[0].removesuffix(".py")
        if room in ROOMS:
            later = [name for name in imported_rooms(path) if ROOMS.index(name) > ROOMS.index(room)]
            backwards += [f"{path.relative_to(SOURCES)} imports {name}" for name in later]
    assert not backwards


@pytest.mark.parametrize("outer", ROOMS_INSIDE)
def test_no_import_within_a_room_runs_backwards(outer: str) -> None:
    backwards = []
    for place, room in enumerate(ROOMS_INSIDE[outer]):
        allowed = ROOMS_INSIDE[outer][: place + 1]
        files = list((SOURCES / outer / room).glob("*.py"))
        assert len(files) > 1, room
        for path in files:
            own = [parts for parts in imported_names(path) if parts[1] == outer]
            backwards += [f"{outer}/{room}/{path.name} imports {'.'.join(parts)}" for parts in own if parts[2] not in allowed]
    assert not backwards
