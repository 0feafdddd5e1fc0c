"""The table of measured heights beside true and published ones, and a plot of the error over the height.

The published heights are the diploma thesis's ("ZeroShOP: Zero-shot object pose estimation in unconstrained environments", TU
Wien, January 2026, Tables 4.3 and 4.4), estimated by MASt3R from photos of real objects; they lie beside this file as
published_heights.csv. An object of the user's own photos that is called as there is taken for the same one. The plot is that of its
Figure 4.8: absolute error in per cent over the true height, with a straight trend.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from zeroshop_steps.report.figure_files import write_figure
from zeroshop_steps.report.site.svg_plots import LEAST_FOR_TREND
from zeroshop_steps.report.table import parse_cell
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.tables import read_table, write_table

PUBLISHED = Path(__file__).with_name("published_heights.csv")
BESIDE, APART, MAST3R, THESIS = "board beside the object", "board in the empty scene", "MASt3R", "thesis: MASt3R"
COLORS = {BESIDE: "tab:orange", APART: "tab:green", MAST3R: "tab:red", THESIS: "tab:blue"}
MARKS = {BESIDE: "^", APART: "v", MAST3R: "s", THESIS: "o"}
FIGURE_INCHES, DOTS_PER_INCH, MARK_POINTS2 = (7.0, 4.5), 150, 24  # as wide as a text column; the area of a mark
COLUMNS = (
    "dataset",
    "object",
    "scene",
    "registration",
    "nvs",
    "how",
    "height_m",
    "measured_height_m",
    "deviation_mm",
    "difference_mm",
    "difference_percent",
    "reason",
    "published_name",
    "published_height_m",
    "published_measured_height_m",
    "published_difference_percent",
)


@dataclass(frozen=True)
class PublishedHeight:
    """A height that the thesis estimated; `ycbv_object` is empty for objects that are not in YCB-V."""

    table: str
    name: str
    ycbv_object: str
    height_m: float
    measured_height_m: float
    difference_percent: float


READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--heights", type=Path, nargs="+", required=True, help="height_by_board.json or height_by_mast3r.json of each cell")
    parser.add_argument("--root", type=Path, default=Path("results"), help="folder that the cells' paths start with (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write; the plot goes beside it as .svg and .png")


def run(args: argparse.Namespace) -> None:
    """Write the table and the plot."""
    published = read_published_heights()
    rows = [make_row(path, args.root, published) for path in args.heights]
    write_table(args.out, [*rows, *list_unmatched(published, rows)], COLUMNS)
    figure = draw_plot(rows, published)
    write_figure(figure, args.out)


def read_published_heights() -> list[PublishedHeight]:
    """The thesis's Tables 4.3 and 4.4."""
    table = read_table(PUBLISHED).rename(columns={"mast3r_height_m": "measured_height_m"}).drop(columns="difference_mm")
    numbers = {"height_m": float, "measured_height_m": float, "difference_percent": float}
    return [PublishedHeight(**row) for row in table.astype(numbers).to_dict("records")]


def make_row(path: Path, root: Path, published: Sequence[PublishedHeight]) -> dict[str, str | float]:
    """One row: the measured and the true height of a cell, or why there is none, and the published heights of the object.

    Raises:
        StepError: the file is missing, or the true height is not in it.
    """
    row: dict[str, str | float] = dict(parse_cell(path, root))
    for found in published:
        name = found.ycbv_object if row["dataset"] == "ycbv" else found.name if row["scene"] == "video" else None
        if row["object"] == name:
            row |= _published_columns(found)
    row["how"] = MAST3R if path.stem == "height_by_mast3r" else BESIDE if row["scene"] == "su_b" else APART
    failure = read_failure(path)
    if failure:
        return row | {"reason": str(failure)}
    record = read_json(path)
    true_m, measured_m = record["known_height_m"], record["height_m"]
    if true_m is None or measured_m is None:
        raise StepError(f"{path} lacks the true or the measured height; only rendered objects that were measured belong into this table")
    return row | {
        "height_m": true_m,
        "measured_height_m": round(measured_m, 6),
        "deviation_mm": round(1000 * record["height_deviation_m"], 3),
        "difference_mm": round(1000 * (measured_m - true_m), 3),
        "difference_percent": round(100 * (measured_m / true_m - 1), 3),
    }


def list_unmatched(published: Sequence[PublishedHeight], rows: Sequence[dict[str, str | float]]) -> list[dict[str, str | float]]:
    """A row for each published height of an object that has no row yet."""
    named = {row.get("published_name") for row in rows}
    return [{"how": THESIS, **_published_columns(found)} for found in published if found.name not in named]


def _published_columns(found: PublishedHeight) -> dict[str, str | float]:
    return {
        "published_name": found.name,
        "published_height_m": found.height_m,
        "published_measured_height_m": found.measured_height_m,
        "published_difference_percent": found.difference_percent,
    }


def draw_plot(rows: Sequence[dict[str, str | float]], published: Sequence[PublishedHeight]) -> Figure:
    """Plot the absolute error in per cent over the true height in metres, ours and the thesis's, with straight trends."""
    figure = Figure(figsize=FIGURE_INCHES, dpi=DOTS_PER_INCH, layout="constrained")
    axes = figure.add_subplot()
    points = {THESIS: np.array([(found.height_m, abs(found.difference_percent)) for found in published])}
    for how in (BESIDE, APART, MAST3R):
        own = [(row["height_m"], abs(float(row["difference_percent"]))) for row in rows if row["how"] == how and "height_m" in row]
        points[how] = np.array(own, float).reshape(-1, 2)
    for how, found in points.items():
        if len(found) == 0:
            continue
        axes.scatter(found[:, 0], found[:, 1], s=MARK_POINTS2, color=COLORS[how], marker=MARKS[how], label=how)
        if len(found) >= LEAST_FOR_TREND:
            slope, level = np.polyfit(found[:, 0], found[:, 1], 1)
            ends = np.array([found[:, 0].min(), found[:, 0].max()])
            axes.plot(ends, level + slope * ends, color=COLORS[how], linewidth=1.0)
    axes.set(xlabel="true height in m", ylabel="error of the measured height in %", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend()
    return figure
