"""The table of robustness: AR of poses with true models, and with the same of a wrong scale or without the underside; and a plot.

The diploma thesis's abstract says that poses stay robust "even in the presence of moderate scale errors in the generated meshes"
("ZeroShOP: Zero-shot object pose estimation in unconstrained environments", TU Wien, January 2026). Errors are those of the estimated
pose applied to the true model, so a wrong scale costs only what it does to the pose.
"""

import argparse
import re
from pathlib import Path

from matplotlib.figure import Figure

from zeroshop_steps.report.figure_files import write_figure
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import read_table, write_table

COLUMNS = ("dataset", "estimator", "masks", "damage", "amount", "measure", "object", "value", "source")
SCALE, UNDERSIDE = "scale", "underside"
FIGURE_INCHES, DOTS_PER_INCH = (7.0, 4.0), 150
SHOWN = {"ar": "AR", "ar_vsd": "AR of VSD", "ar_mssd": "AR of MSSD", "ar_mspd": "AR of MSPD"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--scores", type=Path, nargs="+", required=True, help="scores.csv of a run with each set of models")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write; the plot goes beside it as .svg and .png")


def run(args: argparse.Namespace) -> None:
    """Write the table and the plot."""
    rows = [row for path in args.scores for row in read_run(path)]
    write_table(args.out, rows, COLUMNS)
    figure = draw_plot(rows)
    write_figure(figure, args.out)


def read_run(path: Path) -> list[dict[str, str]]:
    """The rows of one run, once for each kind of damage that its models are a step of: true models are a step of both.

    Raises:
        StepError: the file is missing, or its path names no damage.
    """
    try:
        dataset, _, run = path.parts[-4:-1]
        estimator, masks, models = run.split("-")
    except ValueError:
        raise StepError(f"{path} is no run's; expected DATASET/bop/ESTIMATOR-MASKS-MODELS/scores.csv") from None
    where = {"dataset": dataset, "estimator": estimator, "masks": masks, "source": "measured"}
    return [
        {**where, "damage": damage, "amount": amount, **{name: row[name] for name in ("measure", "object", "value")}}
        for damage, amount in damages_of(models, path)
        for row in read_table(path).to_dict("records")
    ]


def damages_of(models: str, path: Path) -> list[tuple[str, str]]:
    """The kinds and amounts of damage of a folder of models."""
    if models == "models":
        return [(SCALE, "0 %"), (UNDERSIDE, "there")]
    if models == "models_without_underside":
        return [(UNDERSIDE, "missing")]
    scaled = re.fullmatch(r"models_scaled_(minus|plus)_(\d+)", models)
    if not scaled:
        raise StepError(
            f"{path}: {models} names no damage; expected models, models_scaled_plus_5 and the like, or models_without_underside"
        )
    return [(SCALE, f"{'-' if scaled[1] == 'minus' else '+'}{scaled[2]} %")]


def draw_plot(rows: list[dict[str, str]]) -> Figure:
    """Average recalls over the error of the scale in per cent; without the underside, as marks beside."""
    figure = Figure(figsize=FIGURE_INCHES, dpi=DOTS_PER_INCH, layout="constrained")
    axes = figure.add_subplot()
    overall = [row for row in rows if row["object"] == ""]
    for number, (measure, text) in enumerate(SHOWN.items()):
        steps = sorted(
            (float(row["amount"].removesuffix(" %")), float(row["value"]))
            for row in overall if row["damage"] == SCALE and row["measure"] == measure
        )  # fmt: skip
        if steps:
            axes.plot(*zip(*steps, strict=True), marker="o", linewidth=2.2 if measure == "ar" else 1.0, color=f"C{number}", label=text)
        missing = [float(row["value"]) for row in overall if row["amount"] == "missing" and row["measure"] == measure]
        axes.plot([0.0] * len(missing), missing, marker="x", linestyle="none", color=f"C{number}")
    axes.plot([], [], marker="x", linestyle="none", color="black", label="without the underside")
    axes.set(xlabel="error of the models' scale in %", ylabel="average recall", ylim=(0.0, 1.0))
    axes.grid(alpha=0.3)
    axes.legend()
    return figure
