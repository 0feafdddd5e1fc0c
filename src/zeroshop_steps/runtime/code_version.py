"""A fingerprint of the code that a step can execute: its module, all of this package that it imports, and the libraries' versions."""

import ast
import functools
import hashlib
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import packages_distributions, version
from pathlib import Path

PACKAGE = "zeroshop_steps"
SOURCES = Path(__file__).parents[1]
DATA_SUFFIXES = (".json", ".csv")


def code_version(module: str, sources: Path = SOURCES) -> str:
    """The fingerprint of a module of this package, e.g. "surface.twodgs", as hexadecimal digits.

    Imports inside functions count as well. Data files beside an imported module count with it. What a library itself
    depends on does not.
    """
    files, libraries = reached(f"{PACKAGE}.{module}", sources)
    digest = hashlib.sha256(f"python {sys.version_info[0]}.{sys.version_info[1]}\n".encode())
    distributions = _distributions()
    for name in sorted({name for library in libraries for name in distributions.get(library, [])}):
        digest.update(f"{name} {version(name)}\n".encode())
    for path in sorted(files | {data for file in files for data in file.parent.iterdir() if data.suffix in DATA_SUFFIXES}):
        digest.update(f"{path.relative_to(sources)} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


@functools.cache
def _distributions() -> Mapping[str, list[str]]:
    return packages_distributions()


def reached(module: str, sources: Path = SOURCES) -> tuple[set[Path], set[str]]:
    """The package's files that importing and running a module can reach, and the other top-level modules that they name."""
    files: set[Path] = set()
    libraries: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name.partition(".")[0] != PACKAGE:
            libraries.add(name.partition(".")[0])
            continue
        file = _file_of(name, sources)
        if file is None or file in files:
            continue
        files.add(file)
        waiting += [name.rpartition(".")[0], *_imports(ast.parse(file.read_bytes()))]
    return files, libraries


def _imports(tree: ast.AST) -> Iterator[str]:
    """Every name that a module imports, with the names that it takes from a module as if they were modules, too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _file_of(name: str, sources: Path) -> Path | None:
    """The source file of a module of this package; None for a name inside a module."""
    stem = sources.joinpath(*name.split(".")[1:])
    return next((path for path in (stem / "__init__.py", stem.with_suffix(".py")) if name and path.is_file()), None)
