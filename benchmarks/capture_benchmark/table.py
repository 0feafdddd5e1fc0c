"""The table of captures: what each is, what must come out of it, and what is known of it."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import read_table

KINDS = ("real", "rendered", "film")
EXPECTED = ("object", "no_object", "moved", "refused")
HALVES = ("tune", "judge")


def choose_half(name: str) -> str:
    """The half of the object of this name."""
    return HALVES[hashlib.sha1(name.encode()).digest()[0] % 2]


@dataclass(frozen=True)
class Capture:
    """A row of the table.

    Attributes:
        name: of the capture and of all that is written for it.
        object: what it shows. Captures of one object are in one half, whatever their kind.
        kind: real (photos or a film), rendered (photos of a model) or film (a rendered film of a model).
        path: of a real one, the folder of photos or the film below the data folder; else the model (`rendered.write_model`).
        setting: of a rendered one its difficulty, of a rendered film its table; empty for real ones.
        expected: what must come out, several words where any of them is right: an object's mesh; a refusal, because there is no
            single object or because it moved; or a refusal for another good reason.
        height_m: of the object; None where unknown.
        masks: folder of reference masks below the data folder, named as the photos; empty where there is none.
        cameras, mesh: a COLMAP model of true cameras, and the true mesh in its frame, below the data folder; empty where unknown.
    """

    name: str
    object: str
    kind: str
    path: str
    setting: str
    expected: tuple[str, ...]
    height_m: float | None
    masks: str
    cameras: str
    mesh: str

    @property
    def half(self) -> str:
        """tune or judge, by a hash of the object's name: nobody chooses, and no object is in both."""
        return choose_half(self.object)

    @property
    def wants_object(self) -> bool:
        """Whether a mesh may come out; else only a refusal is right."""
        return "object" in self.expected


def read_captures(path: Path) -> list[Capture]:
    """The captures of a table.

    Raises:
        StepError: a column is missing, or a row has a word or a number that is not known; it names the row.
    """
    table = read_table(path)
    columns = [field.name for field in fields(Capture)]
    if missing := [column for column in columns if column not in table]:
        raise StepError(f"{path} lacks the columns {', '.join(missing)}; expected {', '.join(columns)}")
    captures = [_read_row(path, row._asdict()) for row in table[columns].itertuples(index=False)]
    names = [capture.name for capture in captures]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise StepError(f"{path} has several rows named {', '.join(repeated)}; give each capture a name of its own")
    return captures


def _read_row(path: Path, row: dict[str, str]) -> Capture:
    where = f"{path}: {row['name'] or 'a row without a name'}"
    if not row["name"].replace("_", "").replace("-", "").isalnum() or not row["object"]:
        raise StepError(f"{where}: name and object are needed, the name of letters, digits, - and _ only")
    if row["kind"] not in KINDS:
        raise StepError(f"{where}: kind is {row['kind']!r}; expected one of {', '.join(KINDS)}")
    expected = tuple(row["expected"].split("|"))
    if unknown := set(expected) - set(EXPECTED):
        raise StepError(f"{where}: expected is {row['expected']!r}, with {', '.join(unknown)}; give one or more of {'|'.join(EXPECTED)}")
    try:
        height_m = float(row["height_m"]) if row["height_m"] else None
    except ValueError:
        raise StepError(f"{where}: height_m is {row['height_m']!r}; give metres, such as 0.19, or nothing") from None
    return Capture(**{**row, "expected": expected, "height_m": height_m})  # type: ignore[arg-type]


def choose_captures(captures: Sequence[Capture], half: str, only: Sequence[str]) -> list[Capture]:
    """Those of a half ("both" for all) and of these names, all if there are none.

    Raises:
        StepError: a name is not in the table.
    """
    names = {capture.name for capture in captures}
    if unknown := [name for name in only if name not in names]:
        raise StepError(f"the table has no captures named {', '.join(unknown)}; it has {', '.join(sorted(names))}")
    return [one for one in captures if half in ("both", one.half) and (not only or one.name in only)]
