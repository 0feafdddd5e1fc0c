"""How grasps fail where the robot's models have a wrong scale, or lack the underside: a table and a plot, one line an object.

The models are true ones that were damaged on purpose, so that nothing else is wrong with them. The diploma thesis's abstract says that
grasps are robust "even in the presence of moderate scale errors" ("ZeroShOP", TU Wien, January 2026), of which it had no measurement.
"""

import argparse
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from zeroshop_steps.report.figure_files import write_figure
from zeroshop_steps.report.grasping import FIRST, SECOND, mark_poses, read_attempts, sum_marks
from zeroshop_steps.report.robustness import SCALE, UNDERSIDE, damages_of
from zeroshop_steps.runtime.tables import write_table

COLUMNS = ("dataset", "object", "friction", "damage", "amount", "measure", "value")
FIGURE_INCHES, DOTS_PER_INCH = (9.0, 4.0), 150
WIDTHS = (5.0, 2.0)  # of the two plots, relative to each other
APART_PERCENT = 1.0  # between lines of objects that would hide one another, upwards


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--attempts", type=Path, nargs="+", required=True, help="folders DATASET/bop/grasping/MODELS/OBJECT")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write; the plot goes beside it as .svg and .png")


def run(args: argparse.Namespace) -> None:
    """Write the table and the plot."""
    rows = [row for folder in args.attempts for row in read_shares(folder)]
    write_table(args.out, rows, COLUMNS)
    figure = draw_plot(rows)
    write_figure(figure, args.out)


def read_shares(folder: Path) -> list[dict[str, Any]]:
    """The shares of one object with one set of models, once for each kind of damage that these are a step of."""
    attempts = read_attempts(folder)
    shares = [row for row in sum_marks(mark_poses(attempts)) if row.get("object") and row["measure"] in (FIRST, SECOND)]
    return [
        {"damage": damage, "amount": amount, **{name: row[name] for name in ("dataset", "object", "friction", "measure", "value")}}
        for damage, amount in damages_of(folder.parts[-2], folder)
        for row in shares
    ]


def draw_plot(rows: list[dict[str, Any]]) -> Figure:
    """Shares at the first attempt: over the error of the scale, and with and without the underside."""
    figure = Figure(figsize=FIGURE_INCHES, dpi=DOTS_PER_INCH, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, gridspec_kw={"width_ratios": WIDTHS})
    names = list(dict.fromkeys((row["dataset"], row["object"]) for row in rows))
    for number, (dataset, name) in enumerate(names):
        own = [row for row in rows if (row["dataset"], row["object"], row["measure"]) == (dataset, name, FIRST)]
        steps = sorted(
            (float(row["amount"].removesuffix(" %")), float(row["value"]) + APART_PERCENT * number) for row in own if row["damage"] == SCALE
        )
        if steps:
            left.plot(*zip(*steps, strict=True), marker="o", color=f"C{number}", label=f"{dataset} {name}")
        below = {row["amount"]: float(row["value"]) + APART_PERCENT * number for row in own if row["damage"] == UNDERSIDE}
        if len(below) == 2:
            right.plot([0, 1], [below["there"], below["missing"]], marker="o", color=f"C{number}")
    left.set(xlabel="error of the scale of the robot's models in %", ylabel=FIRST, ylim=(-3.0, 108.0))
    right.set(xlabel="underside", xticks=[0, 1], xticklabels=["there", "missing"], xlim=(-0.3, 1.3))
    for axes in (left, right):
        axes.grid(alpha=0.3)
    left.legend()
    return figure
