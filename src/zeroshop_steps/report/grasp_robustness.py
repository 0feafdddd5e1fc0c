"""How grasps fail where the robot's models have a wrong scale, or lack the underside: a table and two plots, one line an object.

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
SCALE_INCHES, UNDERSIDE_INCHES, DOTS_PER_INCH = (7.0, 4.0), (4.5, 4.0), 150
AMOUNTS = ("there", "missing")  # of the underside
APART_PERCENT = 1.0  # between lines of objects that would hide one another, upwards


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--attempts", type=Path, nargs="+", required=True, help="folders DATASET/bop/grasping/MODELS/OBJECT")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write")
    parser.add_argument("--scale-plot", type=Path, required=True, help="plot over the scale's error, written as .svg and .png")
    parser.add_argument("--underside-plot", type=Path, required=True, help="plot with and without the underside, likewise")


def run(args: argparse.Namespace) -> None:
    """Write the table and the plots."""
    rows = [row for folder in args.attempts for row in read_shares(folder)]
    write_table(args.out, rows, COLUMNS)
    write_figure(draw_scale_plot(rows), args.scale_plot)
    write_figure(draw_underside_plot(rows), args.underside_plot)


def read_shares(folder: Path) -> list[dict[str, Any]]:
    """The shares of one object with one set of models, once for each kind of damage that these are a step of."""
    attempts = read_attempts(folder)
    shares = [row for row in sum_marks(mark_poses(attempts)) if row.get("object") and row["measure"] in (FIRST, SECOND)]
    return [
        {"damage": damage, "amount": amount, **{name: row[name] for name in ("dataset", "object", "friction", "measure", "value")}}
        for damage, amount in damages_of(folder.parts[-2], folder)
        for row in shares
    ]


def draw_scale_plot(rows: list[dict[str, Any]]) -> Figure:
    """Shares at the first attempt over the error of the scale."""
    figure = Figure(figsize=SCALE_INCHES, dpi=DOTS_PER_INCH, layout="constrained")
    axes = figure.add_subplot()
    for number, (name, own) in enumerate(_lines(rows).items()):
        steps = sorted((float(amount.removesuffix(" %")), value) for damage, amount, value in own if damage == SCALE)
        axes.plot(*zip(*steps, strict=True), marker="o", color=f"C{number}", label=name)
    axes.set(xlabel="error of the scale of the robot's models in %", ylabel=FIRST, ylim=_limits(rows))
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def draw_underside_plot(rows: list[dict[str, Any]]) -> Figure:
    """Shares at the first attempt with and without the underside."""
    figure = Figure(figsize=UNDERSIDE_INCHES, dpi=DOTS_PER_INCH, layout="constrained")
    axes = figure.add_subplot()
    for number, (name, own) in enumerate(_lines(rows).items()):
        shares = {amount: value for damage, amount, value in own if damage == UNDERSIDE}
        steps = [(place, shares[amount]) for place, amount in enumerate(AMOUNTS) if amount in shares]
        axes.plot(*zip(*steps, strict=True), marker="o", color=f"C{number}", label=name)
    axes.set(
        xlabel="underside of the robot's models", ylabel=FIRST, xticks=[0, 1], xticklabels=AMOUNTS, xlim=(-0.3, 1.3), ylim=_limits(rows)
    )
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def _lines(rows: list[dict[str, Any]]) -> dict[str, list[tuple[str, str, float]]]:
    """Damage, amount and share at the first attempt with each object and friction, each line a little above the one before."""
    lines: dict[str, list[tuple[str, str, float]]] = {}
    for row in rows:
        if row["measure"] == FIRST:
            lines.setdefault(f"{row['object']}, friction {row['friction']}", []).append((row["damage"], row["amount"], float(row["value"])))
    return {
        name: [(damage, amount, value + APART_PERCENT * number) for damage, amount, value in own]
        for number, (name, own) in enumerate(lines.items())
    }


def _limits(rows: list[dict[str, Any]]) -> tuple[float, float]:
    """Of the shares' axis: from 0 to 100 with a margin, and room for the lines that are moved upwards."""
    return -3.0, 103.0 + APART_PERCENT * len(_lines(rows))
