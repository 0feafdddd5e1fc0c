"""Render the reconstruction table: a mark for every cell, with published marks beside them where there are any.

The published grades of YCB-V are the diploma thesis's ("ZeroShOP: Zero-shot object pose estimation in unconstrained
environments", TU Wien, January 2026, Tables 4.1 and 4.2), judged there by eye, from cameras of learned registrations and
Blender renders; they lie beside this file as published_ycbv.csv.
"""

import argparse
import csv
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, median

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write

MARKS = {"none": "×", "sparse": "○", "good": "●"}
SCENES = ("su_l", "su_h", "se")
PUBLISHED = Path(__file__).with_name("published_ycbv.csv")
AVERAGED = {
    "f_score_1_percent": "F-score at 1 %",
    "accuracy_mm": "accuracy, mm",
    "completeness_mm": "completeness, mm",
    "training_seconds": "training, s",
    "training_cpu_seconds": "training, CPU s",
}
SOURCE = "ZeroShOP diploma thesis, TU Wien, January 2026"


@dataclass(frozen=True)
class TableCell:
    """One reconstruction: where it stands in the matrix, and how it went.

    Attributes:
        nvs, registration, scene, object: its coordinates; published ones name their registration in words.
        grade: none, sparse or good; by_photos, by_truth: what either judgement says, None where it was not made.
        figures: its measurements by name, empty where it failed or is published.
        reasons: by measurement, why it is not good.
    """

    nvs: str
    registration: str
    scene: str
    object: str
    grade: str
    figures: dict[str, float]
    reasons: dict[str, str]
    by_photos: str | None = None
    by_truth: str | None = None

    @property
    def place(self) -> str:
        """Its coordinates as a reader finds them."""
        return f"{self.object}, {self.scene}, {self.registration}, {self.nvs}"


READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--table", type=Path, required=True, help="reconstruction.csv")
    parser.add_argument("--published", action="store_true", help="put the thesis's grades of YCB-V beside ours")
    parser.add_argument("--out", type=Path, required=True, help="Markdown to write")


def run(args: argparse.Namespace) -> None:
    cells = read_cells(args.table)
    with atomic_write(args.out) as temporary:
        temporary.write_text(render_page(cells, read_published_cells() if args.published else []))


def read_cells(table: Path) -> list[TableCell]:
    """The cells of a tidy table, in its order. Raises StepError where a cell has no grade, or one that is unknown."""
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    cells: dict[tuple[str, ...], dict[str, dict]] = {}
    for row in rows:
        cells.setdefault((row["nvs"], row["registration"], row["scene"], row["object"]), {})[row["measure"]] = row
    found = []
    for key, measures in cells.items():
        values = {name: row["value"] for name, row in measures.items()}
        if values.get("grade") not in MARKS:
            raise StepError(f"{table}: {', '.join(key)} has the grade {values.get('grade')}; expected one of {', '.join(MARKS)}")
        figures = {name: float(value) for name, value in values.items() if not name.startswith("grade")}
        reasons = {name: row["reason"] for name, row in measures.items() if row.get("reason")}
        found.append(TableCell(*key, values["grade"], figures, reasons, values.get("grade_by_photos"), values.get("grade_by_truth")))
    return found


def read_published_cells() -> list[TableCell]:
    """The thesis's grades of the YCB-V objects."""
    with PUBLISHED.open(newline="") as file:
        return [
            TableCell(row["nvs"], f"thesis: {row['registration']}", row["scene"], row["object"], row["grade"], {}, {})
            for row in csv.DictReader(file)
        ]


def render_page(cells: Sequence[TableCell], published: Sequence[TableCell]) -> str:
    """The whole Markdown text."""
    title = "# Reconstruction\n\n" + ", ".join(f"{mark} {grade}" for grade, mark in MARKS.items()) + "; empty: not asked for."
    if published:
        title += f'\n\nColumns that begin with "thesis" are published grades, judged by eye ({SOURCE}, Tables 4.1 and 4.2).'
    objects = list(dict.fromkeys(cell.object for cell in cells))
    methods = list(dict.fromkeys(cell.nvs for cell in cells))
    parts = [title]
    for nvs in methods:
        columns = [cell for cell in [*cells, *published] if cell.nvs == nvs and cell.object in objects]
        parts.append(f"## {nvs}\n\n{render_marks(columns, objects)}")
    if len(methods) > 1:
        parts.append("## The methods against each other\n\n" + _compare_methods(cells, methods))
    parts.append("## Why cells are not good\n\n" + _render_list(_list_shortcomings(cells)))
    parts.append("## Where photos alone would have judged otherwise\n\n" + _list_disagreements(cells))
    return "\n\n".join(parts) + "\n"


def render_marks(cells: Sequence[TableCell], objects: Sequence[str]) -> str:
    """One row an object, one column a registration and scene; below, how many of each grade, and mean figures."""
    columns: dict[tuple[str, str], dict[str, TableCell]] = {}
    for cell in cells:
        columns.setdefault((cell.registration, cell.scene), {})[cell.object] = cell
    registrations = list(dict.fromkeys(registration for registration, _ in columns))
    order = sorted(columns, key=lambda key: (registrations.index(key[0]), SCENES.index(key[1]) if key[1] in SCENES else len(SCENES)))
    rows = [["", *(f"{registration}<br>{scene}" for registration, scene in order)], ["---", *([":-:"] * len(order))]]
    rows += [[name, *(_mark(columns[key].get(name)) for key in order)] for name in objects]
    for grade in reversed(MARKS):
        rows.append([f"*{grade}*", *(str(sum(cell.grade == grade for cell in columns[key].values())) for key in order)])
    rows.append(["*meshes that means are over*", *(str(sum(bool(cell.figures) for cell in columns[key].values()) or "") for key in order)])
    for measure, text in AVERAGED.items():
        rows.append([f"*mean {text}*", *(_average(mean, columns[key].values(), measure) for key in order)])
    return _render_table(rows)


def _render_table(rows: Iterable[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _compare_methods(cells: Sequence[TableCell], methods: Sequence[str]) -> str:
    """Mean and median figures over the images and cameras from which every method made a mesh."""
    by_input: dict[tuple[str, ...], dict[str, TableCell]] = {}
    for cell in cells:
        if cell.figures:
            by_input.setdefault((cell.object, cell.scene, cell.registration), {})[cell.nvs] = cell
    shared = [meshes for meshes in by_input.values() if len(meshes) == len(methods)]
    if not shared:
        return "Nothing was reconstructed by all of them."
    rows = [["", *methods], ["---", *([":-:"] * len(methods))]]
    for measure, text in AVERAGED.items():
        columns = [[meshes[nvs] for meshes in shared] for nvs in methods]
        for average in (mean, median):
            rows.append([f"*{average.__name__} {text}*", *(_average(average, column, measure) for column in columns)])
    return f"Over the {len(shared)} captures and cameras from which each of them made a mesh.\n\n" + _render_table(rows)


def _list_shortcomings(cells: Sequence[TableCell]) -> Iterator[str]:
    """Each reason once with the methods that it stopped: a failed registration stops all of them."""
    methods: dict[tuple[str, ...], list[str]] = {}
    for cell in cells:
        if "grade" in cell.reasons:
            place = (MARKS[cell.grade], f"{cell.object}, {cell.scene}, {cell.registration}", cell.reasons["grade"])
            methods.setdefault(place, []).append(cell.nvs)
    for (mark, place, reason), names in methods.items():
        yield f"{mark} {place}, {' and '.join(names)}: {reason}"


def _list_disagreements(cells: Sequence[TableCell]) -> str:
    judged = [cell for cell in cells if cell.by_photos and cell.by_truth]
    differing = [cell for cell in judged if cell.by_photos != cell.by_truth]
    if not judged:
        return "No cell has both judgements."
    lines = (
        f"{cell.place}: {_describe_side(cell, 'photos', cell.by_photos)}; {_describe_side(cell, 'truth', cell.by_truth)}"
        for cell in differing
    )
    share = f"{len(judged) - len(differing)} of {len(judged)} cells are judged alike."
    return share + ("\n\n" + _render_list(lines) if differing else "")


def _describe_side(cell: TableCell, side: str, grade: str | None) -> str:
    return f"{MARKS[grade or 'none']} by {side} ({cell.reasons.get(f'grade_by_{side}', 'nothing to object')})"


def _render_list(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines) or "None."


def _mark(cell: TableCell | None) -> str:
    return MARKS[cell.grade] if cell else ""


def _average(average: Callable[[list[float]], float], cells: Iterable[TableCell], measure: str) -> str:
    values = [cell.figures[measure] for cell in cells if measure in cell.figures]
    return f"{average(values):.3g}" if values else ""
