"""Render the reconstruction table as Markdown: a mark for every cell, beside the published marks if there are any.

The published grades of YCB-V are the diploma thesis's ("ZeroShOP: Zero-shot object pose estimation in unconstrained
environments", TU Wien, January 2026, Tables 4.1 and 4.2), judged there by eye, from cameras of learned registrations and
Blender renders; they lie beside this file as published_ycbv.csv.
"""

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import mean, median

import pandas as pd

from zeroshop_steps.methods import WITHOUT_CAMERAS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write
from zeroshop_steps.runtime.tables import read_table

MARKS = {"none": "×", "sparse": "○", "good": "●"}
SCENES = ("su_l", "su_h", "se")
PLACE = ["nvs", "registration", "scene", "object"]
"""The columns with the coordinates of a cell in the matrix."""
GRADES = ["grade", "grade_by_photos", "grade_by_truth"]
"""The grade of a cell, and the grades by photos and by truth."""
PUBLISHED = Path(__file__).with_name("published_ycbv.csv")
AVERAGED = {
    "f_score_1_percent": "F-score at 1 %",
    "accuracy_mm": "accuracy, mm",
    "completeness_mm": "completeness, mm",
    "training_seconds": "training, s",
    "training_cpu_seconds": "training, CPU s",
}
SOURCE = "ZeroShOP diploma thesis, TU Wien, January 2026"

READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--table", type=Path, required=True, help="reconstruction.csv")
    parser.add_argument("--published", action="store_true", help="put the thesis's grades of YCB-V beside ours")
    parser.add_argument("--out", type=Path, required=True, help="Markdown to write")


def run(args: argparse.Namespace) -> None:
    """Write the page."""
    cells = read_cells(args.table)
    with atomic_write(args.out) as temporary:
        temporary.write_text(render_page(cells, read_published_cells() if args.published else None))


def read_cells(path: Path, dataset: str | None = None) -> pd.DataFrame:
    """The cells of a tidy table in its order, one row each; of this dataset alone, if one is named.

    Returns:
        the columns of PLACE; those of GRADES, missing where that judgement was not made; `reason_of_` and each of them, why it is
        not good, "" where it is; `measured`, whether it has any figure; and each of AVERAGED, missing where it was not measured.

    Raises:
        StepError: a cell has no grade, or one that is unknown.
    """
    table = read_table(path)
    table = table[table.dataset == dataset] if dataset else table
    wide = table.assign(reason=table.get("reason", "")).pivot(index=PLACE, columns="measure", values=["value", "reason"])
    wide = wide.reindex(pd.MultiIndex.from_frame(table[PLACE].drop_duplicates()))
    grades = wide["value"].reindex(columns=GRADES)
    for place, grade in grades.grade[~grades.grade.isin(MARKS)].items():
        found = None if pd.isna(grade) else grade
        raise StepError(f"{path}: {', '.join(place)} has the grade {found}; expected one of {', '.join(MARKS)}")
    reasons = wide["reason"].reindex(columns=GRADES).fillna("").add_prefix("reason_of_")
    figures = wide["value"].loc[:, lambda columns: ~columns.columns.str.startswith("grade")]
    measured = figures.notna().any(axis="columns").rename("measured")
    return pd.concat([grades, reasons, measured, figures.reindex(columns=list(AVERAGED)).astype(float)], axis="columns").reset_index()


def read_published_cells() -> pd.DataFrame:
    """The thesis's grades of the YCB-V objects, as `read_cells` gives ours; their registration is named in words."""
    table = read_table(PUBLISHED)
    return table.assign(registration="thesis: " + table.registration, measured=False)


def render_page(cells: pd.DataFrame, published: pd.DataFrame | None = None) -> str:
    """The page as Markdown: our cells beside the published ones."""
    title = "# Reconstruction\n\n" + ", ".join(f"{mark} {grade}" for grade, mark in MARKS.items()) + "; empty: not asked for."
    if published is not None:
        title += f'\n\nColumns that begin with "thesis" are published grades, judged by eye ({SOURCE}, Tables 4.1 and 4.2).'
    objects, methods = cells.object.unique(), cells.nvs.unique()
    shown = pd.concat([cells, published[published.object.isin(objects)]]) if published is not None else cells
    parts = [title, *(f"## {nvs}\n\n{render_marks(shown[shown.nvs == nvs], objects)}" for nvs in methods)]
    finished = cells[cells.registration != WITHOUT_CAMERAS]
    if finished.nvs.nunique() > 1:
        parts.append("## The methods against each other\n\n" + _compare_methods(finished, finished.nvs.unique()))
    parts.append("## Why cells are not good\n\n" + _render_list(_list_shortcomings(cells)))
    parts.append("## Where photos alone would have judged otherwise\n\n" + _list_disagreements(cells))
    return "\n\n".join(parts) + "\n"


def render_marks(cells: pd.DataFrame, objects: Sequence[str]) -> str:
    """A table with a row per object and a column per registration and scene; below, counts of the grades and mean figures."""
    registrations = cells.registration.unique().tolist()
    column = [cells.registration, cells.scene]
    order = sorted(
        cells[["registration", "scene"]].drop_duplicates().itertuples(index=False, name=None),
        key=lambda key: (registrations.index(key[0]), SCENES.index(key[1]) if key[1] in SCENES else len(SCENES)),
    )
    grades = cells.pivot(index="object", columns=["registration", "scene"], values="grade").reindex(index=objects, columns=order)
    rows = [["", *("<br>".join(key) for key in order)], ["---", *([":-:"] * len(order))]]
    rows += [[name, *(MARKS.get(grade, "") for grade in grades.loc[name])] for name in objects]
    rows += [[f"*{grade}*", *map(str, (grades == grade).sum())] for grade in reversed(MARKS)]
    rows.append(["*meshes that means are over*", *(str(count or "") for count in cells.measured.groupby(column).sum()[order])])
    for measure, text in AVERAGED.items():
        rows.append([f"*mean {text}*", *(_average(mean, cells[measure].groupby(column).get_group(key)) for key in order)])
    return _render_table(rows)


def _compare_methods(cells: pd.DataFrame, methods: Sequence[str]) -> str:
    """Mean and median figures over the captures and cameras from which every method made a mesh."""
    meshes = cells[cells.measured]
    pictures = meshes.groupby(["object", "scene", "registration"])
    shared = meshes[pictures.nvs.transform("nunique") == len(methods)]
    if shared.empty:
        return "Nothing was reconstructed by all of them."
    rows = [["", *methods], ["---", *([":-:"] * len(methods))]]
    for measure, text in AVERAGED.items():
        for average in (mean, median):
            rows.append([f"*{average.__name__} {text}*", *(_average(average, shared[measure][shared.nvs == nvs]) for nvs in methods)])
    count = len(shared) // len(methods)
    return f"Over the {count} captures and cameras from which each of them made a mesh.\n\n" + _render_table(rows)


def _list_shortcomings(cells: pd.DataFrame) -> list[str]:
    """Each reason once, with the methods that it concerns: a failed registration concerns all of them."""
    stopped = cells[cells.reason_of_grade != ""]
    methods = stopped.groupby(["grade", "object", "scene", "registration", "reason_of_grade"], sort=False).nvs.agg(" and ".join)
    return [f"{MARKS[grade]} {', '.join(place)}, {names}: {reason}" for (grade, *place, reason), names in methods.items()]


def _list_disagreements(cells: pd.DataFrame) -> str:
    judged = cells.dropna(subset=["grade_by_photos", "grade_by_truth"])
    if judged.empty:
        return "No cell has both judgements."
    differing = judged[judged.grade_by_photos != judged.grade_by_truth]
    lines = [
        f"{cell.object}, {cell.scene}, {cell.registration}, {cell.nvs}: "
        + "; ".join(
            f"{MARKS[grade]} by {side} ({reason or 'nothing to object'})"
            for side, grade, reason in (
                ("photos", cell.grade_by_photos, cell.reason_of_grade_by_photos),
                ("truth", cell.grade_by_truth, cell.reason_of_grade_by_truth),
            )
        )
        for cell in differing.itertuples()
    ]
    share = f"{len(judged) - len(differing)} of {len(judged)} cells are judged alike."
    return share + ("\n\n" + _render_list(lines) if lines else "")


def _render_table(rows: Iterable[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _render_list(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines) or "None."


def _average(average: Callable[[Iterable[float]], float], values: pd.Series) -> str:
    """An average with three digits, computed from exact sums, so that the order of the cells does not matter."""
    measured = values.dropna()
    return f"{average(measured):.3g}" if len(measured) else ""
