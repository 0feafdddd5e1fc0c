"""The table of the benchmark: scores of detectors and pose estimators with true and with reconstructed models.

One row a measurement, and a page with one row a set of models: AP of the detectors' masks, AR of the estimators with true and
with detected masks. The published figures of YCB-V, on its real images, are the diploma thesis's ("ZeroShOP: Zero-shot object
pose estimation in unconstrained environments", TU Wien, January 2026, Table 4.5); they lie beside this file as
published_bop.csv. What its row "official submission" has was scored by BOP itself, of which masks it does not say in every case.
"""

import argparse
import json
import math
from pathlib import Path

import pandas as pd

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import atomic_write, write_json
from zeroshop_steps.runtime.tables import read_table, write_table

PUBLISHED = Path(__file__).with_name("published_bop.csv")
THESIS = "thesis"
RUN = ["source", "task", "method", "masks"]
"""The columns that identify the run of a method."""
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
    parser.add_argument("--real-images", action="store_true", help="the test images are BOP's own, not rendered ones")
    parser.add_argument("--settings", type=json.loads, help="JSON of the settings that the scores were made with")
    parser.add_argument("--settings-out", type=Path, help="JSON to write them to")
    parser.add_argument("--page", type=Path, required=True, help="Markdown to write")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write")


def run(args: argparse.Namespace) -> None:
    """Write the table and its page."""
    parts = [read_scores(path, args.root) for path in args.scores]
    table = pd.concat([*parts, *([read_published()] if args.published else [])], ignore_index=True)
    write_table(args.out, table)
    if args.settings_out:
        write_json(args.settings_out, args.settings)
    with atomic_write(args.page) as temporary:
        temporary.write_text(render_page(table, args.real_images))


def read_scores(path: Path, root: Path) -> pd.DataFrame:
    """The measurements in results/DATASET/bop/DETECTOR-MODELS/precision.csv or .../ESTIMATOR-MASKS-MODELS/scores.csv.

    Of a run that failed, one row: the measure `failed`, whose value is the reason.

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
    failure = read_failure(path)
    table = pd.DataFrame([{"measure": "failed", "object": "", "value": str(failure)}]) if failure else read_table(path)
    return table.assign(**where, source="measured")[list(COLUMNS)]


def read_published() -> pd.DataFrame:
    """The thesis's Table 4.5."""
    return read_table(PUBLISHED).assign(dataset="ycbv", object="", source=THESIS)[list(COLUMNS)]


def render_page(table: pd.DataFrame, real_images: bool = False) -> str:
    """The page as Markdown. `real_images`: the test images are BOP's own."""
    head, *body = summarize_models(table)
    lines = [[title.replace("\n", "<br>") for title in head], ["---", *["--:"] * (len(head) - 1)]]
    lines += [[f"*{name}*" if name.startswith(LOST) else name, *values] for name, *values in body]
    text = "# Detection and pose estimation\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
    text += "\nAP: average precision of masks over IoU 0.5 to 0.95. AR: average recall of VSD, MSSD and MSPD as in the BOP Challenge.\n"
    counts = table[(table.measure == "instances") & (table.object == "")].value
    text += f"{' and '.join(sorted(set(counts)))} instances in {'real' if real_images else 'virtual'} test images.\n" if len(counts) else ""
    if (table.source == THESIS).any():
        text += "Columns of the thesis: YCB-V's real test images (diploma thesis, TU Wien, January 2026, Table 4.5).\n"
    return text


def summarize_models(table: pd.DataFrame) -> list[list[str]]:
    """A row of titles, then a row per set of models with a column per method and masks; below, what each set loses."""
    shown = _select_shown(table[table.object == ""])
    models, runs = shown.models.unique(), _list_runs(shown)
    if not runs:
        return [[""]]
    values = shown.pivot(index="models", columns=RUN, values="value").reindex(index=models, columns=pd.MultiIndex.from_tuples(runs))
    rows = [["", *(_title(*run) for run in runs)], *([_words(name), *map(_number, values.loc[name])] for name in models)]
    for name in models[models != TRUE_MODELS] if TRUE_MODELS in models else []:
        losses = values.loc[TRUE_MODELS] - values.loc[name]
        if losses.notna().any():
            rows.append([f"{LOST} {_words(name)}", *map(_number, losses)])
    return rows


def summarize_objects(table: pd.DataFrame) -> list[list[str]]:
    """A row of titles, then a row per object with a column per set of models, method and masks."""
    shown = _select_shown(table[table.object != ""])
    columns = [(models, *run) for models in shown.models.unique() for run in _list_runs(shown)]
    if not columns:
        return [[""]]
    values = shown.pivot(index="object", columns=["models", *RUN], values="value").reindex(columns=pd.MultiIndex.from_tuples(columns))
    titles = ["", *(f"{_words(models)}: {_title(*run)}" for models, *run in columns)]
    return [titles, *([number, *map(_number, values.loc[number])] for number in sorted(values.index, key=int))]


def _select_shown(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the measure that is shown for each task, with their values as numbers."""
    return table[table.measure == table.task.map(SHOWN)].astype({"value": float})


def _list_runs(shown: pd.DataFrame) -> list[tuple[str, str, str, str]]:
    """The runs in the order of the columns: the thesis's last, detection before poses, true masks before detected ones."""
    runs = shown[RUN].drop_duplicates().itertuples(index=False, name=None)
    return sorted(runs, key=lambda run: (run[0] == THESIS, run[1] == "pose", run[3] != TRUE_MASKS))


def _title(source: str, task: str, method: str, masks: str) -> str:
    whose = f"{THESIS}: " if source == THESIS else ""
    how = "" if task == "detection" else ", true masks" if masks == TRUE_MASKS else f", masks by {masks}"
    return f"{whose}{method}{how}\n{SHOWN[task].upper()}"


def _words(models: str) -> str:
    return "ground truth" if models == TRUE_MODELS else models.removeprefix("models_")


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.3f}"
