"""The index of an object's results: its runs (scene and registration), their cells, and which steps of each are done.

Results need not be complete; missing parts are listed as missing.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from zeroshop_steps.methods import SURFACES
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import Failure, read_failure
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.tables import read_table

# Folders beside scenes, registrations and cells that are none of them.
NO_SCENE = {"model", "logs", "benchmarks", "report"}
NO_REGISTRATION = {"capture", "logs", "benchmarks", "empty_scene", "whole_scene"}
NO_CELL = {"cameras", "scene", "empty_scene", "scratch", "stereo", "logs", "benchmarks"}
# What tells a cell from a folder of another kind, where its name does not.
CELL_FILES = ("outcome.json", "mesh.ply", "raw_mesh.ply", "splats", "voxels")
TRAINED = ("splats/training.json", "voxels/training.json")
# The way from input to mesh: what a step is called, and the files of which it leaves one.
STEPS = (
    ("capture", ("../../capture/capture.json",)),
    ("register", ("../cameras/registration.json",)),
    ("stereo", ("../stereo/stereo.json",)),
    ("train", TRAINED),
    ("raw mesh", ("raw_mesh.ply",)),
    ("shape", ("closed.ply",)),
    ("texture", ("mesh.ply",)),
    ("grade", ("grade.json",)),
)


@dataclass(frozen=True)
class Cell:
    """One reconstruction of an object.

    Attributes:
        scene, registration, nvs: its coordinates; folder: where it lies.
        state: done, failed, unfinished.
        failure: which step failed and why, where one did.
        steps: the steps behind it with whether each is done.
        grade: none, sparse, good; None where it was not judged.
        figures: its measurements by name.
        facts: the content of its JSON files by name, empty where they are missing.
    """

    scene: str
    registration: str
    nvs: str
    folder: Path
    state: str
    failure: Failure | None
    steps: tuple[tuple[str, bool], ...]
    grade: str | None
    figures: dict[str, float]
    facts: dict[str, dict] = field(repr=False)

    @property
    def key(self) -> str:
        """Its coordinates in one word."""
        return f"{self.scene}-{self.registration}-{self.nvs}"

    @property
    def steps_done(self) -> int:
        """The number of its steps that are done."""
        return sum(done for _, done in self.steps)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not good: one line per measure, or the reason of the failed step."""
        if self.failure:
            return (str(self.failure),)
        return tuple(self.facts["grade"].get("reasons", ()))


@dataclass(frozen=True)
class Run:
    """A capture with one registration, and the cells that use it."""

    scene: str
    registration: str
    folder: Path
    registered: dict
    cells: tuple[Cell, ...]

    @property
    def key(self) -> str:
        """Its coordinates as one word."""
        return f"{self.scene}-{self.registration}"

    @property
    def capture(self) -> Path:
        """The folder of its pictures."""
        return self.folder.parent / "capture"

    @property
    def captured(self) -> dict:
        """The record of its pictures; empty where there is none yet."""
        return read_facts(self.capture / "capture.json")

    @property
    def failed(self) -> str | None:
        """Why no cameras were found; None if they were found, or if the registration has not run."""
        failure = read_failure(self.folder / "cameras")
        return failure.reason if failure else None


def find_runs(folder: Path) -> list[Run]:
    """The runs in an object's folder, sorted by name; none if the folder is missing."""
    runs = []
    for scene in _list_folders(folder, NO_SCENE):
        for registration in _list_folders(scene, NO_REGISTRATION):
            registered = read_facts(registration / "cameras/registration.json")
            cells = tuple(read_cell(path) for path in _list_folders(registration, NO_CELL) if _is_cell(path))
            if registered or cells or (registration / "cameras").exists():
                runs.append(Run(scene.name, registration.name, registration, registered, cells))
    return runs


def read_cell(folder: Path) -> Cell:
    """Read what exists of a cell."""
    failure = _find_failure(folder) or read_failure(folder.parent / "cameras")
    names = ("mesh", "quality", "grade", "frame", "clean", "raw_mesh", "height", "closed")
    facts = {name: read_facts(folder / f"{name}.json") for name in names}
    facts["training"] = next((found for name in TRAINED if (found := read_facts(folder / name))), {})
    grade = facts["grade"].get("grade")
    done = (folder / "mesh.ply").is_file() and read_failure(folder / "mesh.ply") is None
    if not grade and (failure or not done):
        grade = "none" if failure else None
    figures = {name: value for name, value in facts["quality"].items() if isinstance(value, int | float) and not isinstance(value, bool)}
    for side in ("photos", "truth"):
        figures |= (facts["grade"].get(side) or {}).get("measures", {})
    state = "failed" if failure else "done" if done and grade else "unfinished"
    steps = tuple((name, any(_is_made(folder / file) for file in files)) for name, files in STEPS)
    return Cell(folder.parents[1].name, folder.parent.name, folder.name, folder, state, failure, steps, grade, figures, facts)


def find_table(path: Path) -> pd.DataFrame:
    """The rows of a CSV as text; none if it is missing, empty or records a failure."""
    if not path.is_file() or read_failure(path):
        return pd.DataFrame()
    try:
        return read_table(path)
    except StepError:
        return pd.DataFrame()


def _is_cell(folder: Path) -> bool:
    return folder.name in SURFACES or any((folder / name).exists() for name in CELL_FILES)


def _find_failure(folder: Path) -> Failure | None:
    files = [folder / "outcome.json", *(folder / name for _, names in STEPS for name in names)]
    return next((failure for path in files if (failure := read_failure(path))), None)


def _is_made(path: Path) -> bool:
    return path.exists() and read_failure(path) is None


def read_facts(path: Path) -> dict[str, Any]:
    """The JSON object in a file; empty if the file is missing, damaged or records a failure."""
    if not path.is_file() or read_failure(path):
        return {}
    try:
        content = read_json(path)
    except StepError:
        return {}
    return content if isinstance(content, dict) else {}


def _list_folders(folder: Path, but: set[str]) -> Iterator[Path]:
    if folder.is_dir():
        yield from sorted(path for path in folder.iterdir() if path.is_dir() and path.name not in but and not path.name.startswith("."))
