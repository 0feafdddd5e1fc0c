"""The table of captures that `zeroshop` was given in a folder: results/photos/captures.tsv, a table of objects as the workflow reads it.

One row an object, so that each name belongs to one input, and the same input with another height makes only what depends on it.
"""

import csv
import re
from dataclasses import dataclass, fields, replace
from pathlib import Path

from zeroshop_steps.runtime.config_files import RESERVED_NAMES
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write, locked

DATASET = "photos"
TABLE = Path("results") / DATASET / "captures.tsv"


@dataclass(frozen=True)
class Capture:
    """One row: what the user gave for an object. Paths are absolute; an empty cell stands for nothing."""

    object: str
    images: str
    images_2: str = ""
    images_3: str = ""
    masks: str = ""
    prompt: str = ""
    picture_count: str = ""
    height_m: str = ""
    height_method: str = ""
    marker_images: str = ""
    depth: str = ""
    scene_of: str = ""
    number: str = ""
    cameras: str = ""
    masks_2: str = ""
    masks_3: str = ""
    depth_2: str = ""
    depth_3: str = ""
    cameras_2: str = ""
    cameras_3: str = ""


COLUMNS = ["dataset", *(field.name for field in fields(Capture))]


def make_name(source: Path) -> str:
    """A name for the results of a film or a folder of photos: that of the file, with letters, digits, _ and - alone.

    Raises:
        StepError: nothing of the name can be kept, or it belongs to the workflow.
    """
    stem = source.stem if source.is_file() else source.name
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_-")
    if not name or name in RESERVED_NAMES:
        raise StepError(f"{source} gives no name for the results; give one with --name, of letters, digits, _ and -")
    return name


def read_captures(folder: Path) -> dict[str, Capture]:
    """The captures named so far in a folder, by object."""
    path = folder / TABLE
    if not path.is_file():
        return {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file, delimiter="\t"))
        return {row["object"]: Capture(**{field.name: row[field.name] for field in fields(Capture) if field.name in row}) for row in rows}
    except (KeyError, UnicodeDecodeError, csv.Error) as error:
        raise StepError(f"{path} is not the table that zeroshop writes ({error}); delete it, and name your captures again") from None


def add_capture(folder: Path, capture: Capture) -> Capture:
    """Put a capture into the table of a folder, and return its row; another run that does so at the same time waits.

    What is given again for the same input replaces what was; what is left out stays as it was.

    Raises:
        StepError: the name belongs to another input, or its results were made from another table.
    """
    table = folder / TABLE
    with locked(table.with_name(f".{table.name}.lock")):
        return _add(folder, capture)


def _add(folder: Path, capture: Capture) -> Capture:
    captures = read_captures(folder)
    earlier = captures.get(capture.object)
    if earlier and earlier.images != capture.images:
        raise StepError(f"the name {capture.object} belongs to {earlier.images} in {folder / TABLE}; give this one another with --name")
    if not earlier and (folder / "results" / DATASET / capture.object).exists():
        raise StepError(
            f"{folder / 'results' / DATASET / capture.object} holds results of another table of objects; give another --name, or another"
            " folder with --into"
        )
    if earlier:
        given = {field.name: value for field in fields(Capture) if (value := getattr(capture, field.name))}
        capture = replace(earlier, **given)
    captures[capture.object] = capture
    with atomic_write(folder / TABLE) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter="\t", lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([DATASET, *(getattr(row, field.name) for field in fields(Capture))] for row in captures.values())
    return capture
