"""Fingerprints of the code that a step can execute: its module and all of this package that it imports, without comments and docstrings.

The workflow has that of each job's step as a parameter, so that changed code makes results stale; the shared cache's (cache.py) counts the
libraries' versions as well.
"""

import ast
import contextlib
import functools
import hashlib
import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import packages_distributions, version
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write

PACKAGE = "zeroshop_steps"
SOURCES = Path(__file__).parents[1]
DATA_SUFFIXES = (".json", ".csv")
KEPT = Path("__pycache__/code_digests.json")
"""Where the digests of files are kept, below the sources, as Python keeps bytecode there: parsing the files of a plan takes a second."""


@dataclass(frozen=True)
class Digest:
    """What is known of a file.

    Attributes:
        stamp: its time in nanoseconds and its size, by which a change is told.
        digest: of its content.
        imports: what it imports, with the names that it takes from a module as if they were modules, too; of data files, nothing.
    """

    stamp: tuple[int, int]
    digest: str
    imports: tuple[str, ...] = ()


class Digests:
    """The digests of the files below a folder of sources; those that were read before are kept."""

    def __init__(self, sources: Path = SOURCES) -> None:
        self.sources, self._changed = sources, False
        self._known: dict[str, Digest] = {}
        try:
            kept = json.loads((sources / KEPT).read_text())
            self._known = {name: Digest(tuple(row["stamp"]), row["digest"], tuple(row["imports"])) for name, row in kept.items()}
        except (OSError, ValueError, KeyError, TypeError):
            pass  # there are none yet, or of another version

    def of(self, path: Path) -> Digest:
        """The digest of a file."""
        found, name = path.stat(), _name_of(path, self.sources)
        stamp = (found.st_mtime_ns, found.st_size)
        known = self._known.get(name)
        if known is None or known.stamp != stamp:
            known = self._known[name] = _digest_file(path, stamp)
            self._changed = True
        return known

    def keep(self) -> None:
        """Write those that are new to the disk, if that is allowed."""
        if not self._changed:
            return
        self._changed = False
        # Where that is not allowed, the next run reads the files again.
        with contextlib.suppress(StepError), atomic_write(self.sources / KEPT) as temporary:
            temporary.write_text(json.dumps({name: asdict(digest) for name, digest in self._known.items()}))


def source_version(modules: tuple[str, ...], sources: Path = SOURCES) -> str:
    """The fingerprint of modules of this package, e.g. ("surface.twodgs",), and of all of the package that they import.

    Imports inside functions count as well. Data files beside an imported module count with it.
    """
    digests = _read_digests(sources)
    files: set[Path] = set()
    for module in modules:
        files |= reached(f"{PACKAGE}.{module}", sources)[0]
    data = {file for folder in {file.parent for file in files} for file in folder.iterdir() if file.suffix in DATA_SUFFIXES}
    digest = hashlib.sha256()
    for path in sorted(files | data):
        digest.update(f"{_name_of(path, sources)} {digests.of(path).digest}\n".encode())
    digests.keep()
    return digest.hexdigest()


def code_version(module: str, sources: Path = SOURCES) -> str:
    """The fingerprint of a module, as `source_version`, with the versions of Python and of the libraries that it names.

    What a library itself depends on does not count.
    """
    _, libraries = reached(f"{PACKAGE}.{module}", sources)
    digest = hashlib.sha256(f"python {sys.version_info[0]}.{sys.version_info[1]}\n".encode())
    distributions = _distributions()
    for name in sorted({name for library in libraries for name in distributions.get(library, [])}):
        digest.update(f"{name} {version(name)}\n".encode())
    digest.update(source_version((module,), sources).encode())
    return digest.hexdigest()


@functools.cache
def _read_digests(sources: Path) -> Digests:
    return Digests(sources)


@functools.cache
def _distributions() -> Mapping[str, list[str]]:
    return packages_distributions()


def reached(module: str, sources: Path = SOURCES) -> tuple[set[Path], set[str]]:
    """The package's files that importing and running a module can reach, and the other top-level modules that they name."""
    digests = _read_digests(sources)
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
        waiting += [name.rpartition(".")[0], *digests.of(file).imports]
    return files, libraries


def _digest_file(path: Path, stamp: tuple[int, int]) -> Digest:
    content = path.read_bytes()
    if path.suffix != ".py":
        return Digest(stamp, hashlib.sha256(content).hexdigest())
    tree = ast.parse(content)
    imports = tuple(dict.fromkeys(_imports(tree)))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = node.body[ast.get_docstring(node, False) is not None :]
    # Without places in the text, so that comments do not count.
    return Digest(stamp, hashlib.sha256(ast.dump(tree).encode()).hexdigest(), imports)


def _imports(tree: ast.AST) -> Iterator[str]:
    """Every name that a module imports, with the names that it takes from a module as if they were modules, too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@functools.cache
def _name_of(path: Path, sources: Path) -> str:
    return str(path.relative_to(sources))


@functools.cache
def _file_of(name: str, sources: Path) -> Path | None:
    """The source file of a module of this package; None for a name inside a module."""
    stem = sources.joinpath(*name.split(".")[1:])
    return next((path for path in (stem / "__init__.py", stem.with_suffix(".py")) if name and path.is_file()), None)
