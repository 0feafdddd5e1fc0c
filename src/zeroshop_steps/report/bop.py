"""The benchmark's table: what detectors and pose estimators reach with true and with reconstructed models.

One row a measurement, and a page with one row a set of models: AP of the detectors' masks, AR of the estimators with true and
with detected masks. The published figures of YCB-V, on its real images, are the diploma thesis's ("ZeroShOP: Zero-shot object
pose estimation in unconstrained environments", TU Wien, January 2026, Table 4.5); they lie beside this file as
published_bop.csv. What its row "official submission" has was scored by BOP itself, of which masks it does not say in every case.
"""

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

from zeroshop_steps.report.table import read_rows
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write

PUBLISHED = Path(__file__).with_name("published_bop.csv")
THESIS = "thesis"
COLUMNS = ("dataset", "models", "task", "method", "masks", "measure", "object", "value", "source")
TRUE_MODELS, TRUE_MASKS = "models", "truth"
LOST = "lost with"
SHOWN = {"detection": "ap", "pose": "ar"}

READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--scores", type=Path, nargs="+", required=True, help="precision.csv and scores.csv of every run")
    parser.add_argument("--root", type=Path, default=Path("results"), help="folder that their paths start with (default: %(default)s)")
    parser.add_argument("--published", action="store_true", help="put the thesis's figures of YCB-V beside them")
    parser.add_argument("--page", type=Path, required=True, help="Markdown to write")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write")


def run(args: argparse.Namespace) -> None:
    """Write the table and its page."""
    rows = [row for path in args.scores for row in read_scores(path, args.root)]
    if args.published:
        rows += read_published()
    with atomic_write(args.out) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(rows)
    with atomic_write(args.page) as temporary:
        temporary.write_text(render_page(rows))


def read_scores(path: Path, root: Path) -> list[dict[str, str]]:
    """The measurements in results/DATASET/bop/DETECTOR-MODELS/precision.csv or .../ESTIMATOR-MASKS-MODELS/scores.csv.

    Raises:
        StepError: the file is missing or empty, or its path tells no run.
    """
    try:
        dataset, _, run = path.relative_to(root).parent.parts
        *method, models = run.split("-")
        name, masks = method if len(method) == 2 else (*method, "")
    except ValueError:
        raise StepError(f"{path} is no run's; expected {root}/DATASET/bop/DETECTOR-MODELS or ESTIMATOR-MASKS-MODELS, and a CSV") from None
    where = {"dataset": dataset, "models": models, "task": "pose" if masks else "detection", "method": name, "masks": masks}
    return [where | {key: row[key] for key in ("measure", "object", "value")} | {"source": "measured"} for row in read_rows(path)]


def read_published() -> list[dict[str, str]]:
    """The thesis's Table 4.5."""
    with PUBLISHED.open(newline="") as file:
        return [{"dataset": "ycbv", **row, "object": "", "source": THESIS} for row in csv.DictReader(file)]


def render_page(rows: Sequence[dict[str, str]]) -> str:
    """The whole Markdown text."""
    head, *body = summarize_models(rows)
    lines = [[title.replace("\n", "<br>") for title in head], ["---", *["--:"] * (len(head) - 1)]]
    lines += [[f"*{name}*" if name.startswith(LOST) else name, *values] for name, *values in body]
    text = "# Detection and pose estimation\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
    text += "\nAP: average precision of masks over IoU 0.5 to 0.95. AR: average recall of VSD, MSSD and MSPD as in the BOP Challenge.\n"
    counts = {row["value"] for row in rows if row["measure"] == "instances" and not row["object"]}
    text += f"{' and '.join(sorted(counts))} instances in virtual test images.\n" if counts else ""
    if any(row["source"] == THESIS for row in rows):
        text += "Columns of the thesis: YCB-V's real test images (diploma thesis, TU Wien, January 2026, Table 4.5).\n"
    return text


def summarize_models(rows: Sequence[dict[str, str]]) -> list[list[str]]:
    """One row a set of models, one column a method and its masks, after a row of titles; below, what each set loses."""
    shown = [row for row in rows if not row["object"] and row["measure"] == SHOWN[row["task"]]]
    columns = _columns(shown)
    values = {(row["models"], _column(row)): float(row["value"]) for row in shown}
    models = list(dict.fromkeys(row["models"] for row in shown))
    table = [["", *(_title(*column) for column in columns)]]
    for name in models:
        table.append([_words(name), *(_number(values.get((name, column))) for column in columns)])
    for name in models:
        compared = [column for column in columns if (name, column) in values and (TRUE_MODELS, column) in values]
        if name != TRUE_MODELS and compared:
            losses = {column: values[TRUE_MODELS, column] - values[name, column] for column in compared}
            table.append([f"{LOST} {_words(name)}", *(_number(losses.get(column)) for column in columns)])
    return table


def summarize_objects(rows: Sequence[dict[str, str]]) -> list[list[str]]:
    """One row an object of BOP's number, one column a set of models, a method and its masks, after a row of titles."""
    shown = [row for row in rows if row["object"] and row["measure"] == SHOWN[row["task"]]]
    columns = [(models, column) for models in dict.fromkeys(row["models"] for row in shown) for column in _columns(shown)]
    values = {(row["object"], row["models"], _column(row)): float(row["value"]) for row in shown}
    table = [["", *(f"{_words(models)}: {_title(*column)}" for models, column in columns)]]
    for number in sorted({row["object"] for row in shown}, key=int):
        table.append([number, *(_number(values.get((number, *column))) for column in columns)])
    return table


def _columns(rows: Sequence[dict[str, str]]) -> list[tuple[str, str, str, str]]:
    return sorted(dict.fromkeys(_column(row) for row in rows), key=lambda key: (key[0] == THESIS, key[1] == "pose", key[3] != TRUE_MASKS))


def _column(row: dict[str, str]) -> tuple[str, str, str, str]:
    return row["source"], row["task"], row["method"], row["masks"]


def _title(source: str, task: str, method: str, masks: str) -> str:
    whose = f"{THESIS}: " if source == THESIS else ""
    how = "" if task == "detection" else ", true masks" if masks == TRUE_MASKS else f", masks by {masks}"
    return f"{whose}{method}{how}\n{SHOWN[task].upper()}"


def _words(models: str) -> str:
    return "ground truth" if models == TRUE_MODELS else models.removeprefix("models_")


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"
