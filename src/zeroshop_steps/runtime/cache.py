"""Results of costly steps in a folder that several checkouts and people share.

The folder is named by ZEROSHOP_CACHE. A result is found by what it depends on: the bytes of the step's inputs, its options,
and the code that it runs (code_version.py). Paths, times and the number of threads do not count. A result is copied, never linked,
and every file is checked against its SHA-256: a damaged entry is removed and made again. Where an entry cannot be copied
or removed, the step runs without the cache, and the entry stays.

A method takes part by naming its dependencies in `CACHED`.

Snakemake has a cache between workflows, too (`cache: True`, SNAKEMAKE_OUTPUT_CACHE). It cannot replace this one
(Snakemake 9.27; tests/runtime/test_snakemake_cache.py shows each point):

- Its key holds the shell command before wildcards are filled in, and of an input that another rule makes only that rule's key. A rule
  that uses `{wildcards.object}` is given the file of another object.
- The code that a command runs is not part of the key, so the results of an older version are used.
- Entries are used unchecked, and through symbolic links: what writes into a result writes into everybody's.
- Rules with `benchmark:` may not take part; the seconds of every stage come from there.
"""

import argparse
import contextlib
import hashlib
import json
import os
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from zeroshop_steps.runtime.code_version import code_version
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory
from zeroshop_steps.runtime.temporary import temporary_folder

LOCATION = "ZEROSHOP_CACHE"
FORMER_LOCATION = "SNAKEMAKE_OUTPUT_CACHE"
MANIFEST = "manifest.json"


@dataclass(frozen=True)
class Cached:
    """What a method's result depends on and consists of.

    Attributes:
        inputs: arguments that name a file or folder, each with a folder inside where only that is read: "capture/images".
            A file counts with those beside it whose names begin with its stem.
        ignored: arguments that do not change the result; `out` never does.
        outputs: the files in the folder `out` that are the result; empty where it is all of the folder.
    """

    inputs: tuple[str, ...]
    ignored: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


class Damaged(Exception):
    """A cache entry is not what was put into it."""


def cache_folder() -> Path | None:
    """The shared folder; None where there is none.

    Raises:
        StepError: what ZEROSHOP_CACHE names is no folder, or nothing can be written there.
    """
    place = os.environ.get(LOCATION)
    if not place:
        return None
    folder = Path(place)
    remedy = f"Name a folder that you may write to in {LOCATION}, or unset it to work without a shared cache."
    if not folder.is_dir():
        raise StepError(f"the cache {place} is no folder on this machine. {remedy}") from NotADirectoryError(place)
    try:
        with tempfile.TemporaryDirectory(dir=folder):
            pass
    except OSError as error:
        raise StepError(f"the cache {place} is not writable ({error.strerror or error}). {remedy}") from error
    return folder


def check_cache() -> None:
    """Check before a run that the shared folder can be used; a folder that only the variable's former name gives is warned of.

    Raises:
        StepError: as `cache_folder`.
    """
    if cache_folder() is None and os.environ.get(FORMER_LOCATION):
        warn(f"{FORMER_LOCATION} is for Snakemake's own cache; the cache of this workflow is now named by {LOCATION}, and none is in use")


def run_cached(step: str, module: ModuleType, args: argparse.Namespace) -> None:
    """Run a step, or take its result from the cache; `step` is its module below this package, e.g. "surface.twodgs"."""
    cached: Cached | None = getattr(module, "CACHED", None)
    folder = cache_folder() if cached else None
    if not cached or not folder:
        module.run(args)
        return
    entry = folder / entry_name(step, cached, args)
    if entry.is_dir():
        try:
            _take(entry, Path(args.out), cached)
            print(f"taken from the cache: {entry}", file=sys.stderr)
            return
        except Damaged as fault:
            if _remove(entry):
                warn(f"cache entry {entry} was damaged ({fault}); it is removed and made again")
            else:
                warn(f"cache entry {entry} is damaged ({fault}) and yours not to remove: its owner may delete it; made without the cache")
        except OSError as error:
            warn(f"cache entry {entry} cannot be copied ({error}); made without the cache")
    module.run(args)
    if entry.exists():
        return
    try:
        _put(entry, Path(args.out), cached)
    except OSError as error:
        warn(f"the result could not be put into the cache {folder}: {error}")


def entry_name(step: str, cached: Cached, args: argparse.Namespace) -> str:
    """The name of the entry for a step's result: the step and a digest of everything that the result depends on."""
    arguments = vars(args)
    apart = {"out", *cached.ignored, *(name.partition("/")[0] for name in cached.inputs)}
    content = {
        "options": {name: value for name, value in sorted(arguments.items()) if name not in apart},
        "inputs": {name: content_digest(_input_path(name, arguments)) for name in cached.inputs},
        "code": code_version(step),
    }
    return f"{step}-{hashlib.sha256(json.dumps(content, default=str).encode()).hexdigest()}"


def content_digest(path: Path) -> str:
    """A digest of a folder's names and bytes, or of a file and those beside it that begin with its stem.

    Hidden files do not count, nor do records of checks (.sha256).
    """
    base = path if path.is_dir() else path.parent
    found = base.rglob("*") if path.is_dir() else base.glob(f"{path.stem}*")
    files = {str(file.relative_to(base)): file for file in found if file.is_file() and file.suffix != ".sha256"}
    digest = hashlib.sha256()
    for name in sorted(name for name in files if not Path(name).name.startswith(".")):
        digest.update(f"{name} {_sha256(files[name])}\n".encode())
    return digest.hexdigest()


def _input_path(name: str, arguments: dict[str, object]) -> Path:
    argument, _, inside = name.partition("/")
    return Path(str(arguments[argument])) / inside


def _take(entry: Path, out: Path, cached: Cached) -> None:
    """Copy an entry to `out` and check every file; nothing is written where one is damaged."""
    try:
        manifest: dict[str, str | None] = json.loads((entry / MANIFEST).read_text())
    except (ValueError, FileNotFoundError) as error:
        raise Damaged(f"{MANIFEST}: {error}") from None
    out.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(out.parent, out.name) as folder:
        scratch = folder / "content"
        for name, digest in manifest.items():
            target = scratch / name
            if digest is None:
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            if not (entry / "content" / name).is_file():
                raise Damaged(f"{name} is missing")
            shutil.copyfile(entry / "content" / name, target)
            if _sha256(target) != digest:
                raise Damaged(f"{name} has changed")
        if cached.outputs:
            if set(manifest) != set(cached.outputs):
                raise Damaged("it lacks files")
            out.mkdir(exist_ok=True)
            for name in cached.outputs:
                os.replace(scratch / name, out / name)
        else:
            with atomic_directory(out) as whole:
                for child in scratch.iterdir():
                    shutil.move(child, whole / child.name)


def _put(entry: Path, out: Path, cached: Cached) -> None:
    """Copy a result into the cache, whole or not at all; an entry that someone else has put there meanwhile stays."""
    with temporary_folder(entry.parent, "new") as scratch:
        manifest: dict[str, str | None] = {}
        for path in [out / name for name in cached.outputs] or sorted(out.rglob("*")):
            name = str(path.relative_to(out))
            if path.name.startswith("."):
                continue
            target = scratch / "content" / name
            if path.is_dir():
                target.mkdir(parents=True, exist_ok=True)
                manifest[name] = None
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, target)
                manifest[name] = _sha256(path)
        (scratch / MANIFEST).write_text(json.dumps(manifest, indent=1))
        _share(scratch, entry.parent)
        with contextlib.suppress(FileExistsError):
            if not entry.exists():
                os.rename(scratch, entry)


def _share(entry: Path, folder: Path) -> None:
    """Let everybody read an entry who may read the folder of the cache, whatever this user's umask."""
    readers = folder.stat().st_mode & 0o044
    for path in (entry, *entry.rglob("*")):
        path.chmod(path.stat().st_mode | readers | (readers >> 2 if path.is_dir() else 0))


def _remove(entry: Path) -> bool:
    """Remove an entry at once, so that nobody finds half of it; whether that could be done."""
    with temporary_folder(entry.parent, "damaged") as gone, contextlib.suppress(OSError):
        os.rename(entry, gone / "entry")
    return not entry.exists()


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
