"""The results table, its summary, and the page that shows what got worse first."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from capture_benchmark.scores import OUTCOMES, RIGHT_WORST, find_worse
from zeroshop_steps.runtime.files import atomic_write
from zeroshop_steps.runtime.tables import read_table, write_table

TABLE, PAGE = "results.csv", "index.html"
SHOWN = (
    "name", "half", "expected", "outcome", "registered", "left_out", "mask_iou_median", "mask_iou_worst", "mesh_iou_median",
    "mesh_iou_worst", "psnr_db", "grade", "wall_s", "cpu_s", "memory_mb",
)  # fmt: skip


def write_results(
    rows: Sequence[Mapping[str, Any]], out: Path, pictures: Sequence[str], earlier: Path | None
) -> list[tuple[str, list[str]]]:
    """Write the results table and the page; what got worse since an earlier results table comes back, by capture.

    Args:
        rows: one a capture.
        out: folder to write; a capture's pictures lie in `out`/NAME.
        pictures: names of those pictures, in the order in which they are shown.
        earlier: a results table of before.
    """
    write_table(out / TABLE, list(rows))
    worse = compare_tables(rows, earlier) if earlier else []
    order = [name for name, _ in worse]
    shown = sorted(
        rows, key=lambda row: (order.index(row["name"]) if row["name"] in order else len(order), -OUTCOMES.index(row["outcome"]))
    )
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    columns = [column for column in SHOWN if any(row.get(column) not in (None, "") for row in rows)]
    found = {row["name"]: [f"{row['name']}/{name}" for name in pictures if (out / row["name"] / name).is_file()] for row in rows}
    text = environment.get_template("page.html").render(
        rows=[{column: row.get(column) for column in {*SHOWN, "kind", "reason", *row}} for row in shown],
        worse=worse,
        summary=summarize(rows),
        columns=columns,
        pictures=found,
    )
    with atomic_write(out / PAGE) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return worse


def compare_tables(rows: Sequence[Mapping[str, Any]], earlier: Path) -> list[tuple[str, list[str]]]:
    """What got worse, by capture; captures that only one table has are left out. Raises StepError where there is no such table."""
    before = {row["name"]: row for row in read_table(earlier).to_dict("records")}
    found = [(row["name"], find_worse(row, before[row["name"]])) for row in rows if row["name"] in before]
    return [(name, words) for name, words in found if words]


def summarize(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A row for each half and kind, and for each half: how often which outcome, and medians."""
    groups = {(half, kind) for half in {row["half"] for row in rows} for kind in ("all", *{row["kind"] for row in rows})}
    summary = []
    for half, kind in sorted(groups):
        chosen = [row for row in rows if row["half"] == half and kind in ("all", row["kind"])]
        if not chosen:
            continue
        medians, worst = (_values(chosen, column) for column in ("mask_iou_median", "mask_iou_worst"))
        good = sum(row["outcome"] in ("right", "rightly refused") for row in chosen)
        summary.append(
            {"half": half, "kind": kind, "captures": len(chosen)}
            | {outcome: sum(row["outcome"] == outcome for row in chosen) for outcome in OUTCOMES}
            | {
                "right or rightly refused, %": round(100 * good / len(chosen), 1),
                "IoU, median": round(float(np.median(medians)), 4) if medians else None,
                f"worst photo >= {RIGHT_WORST:g}, %": round(100 * float(np.mean(np.array(worst) >= RIGHT_WORST)), 1) if worst else None,
                "CPU, s": round(sum(_values(chosen, "cpu_s")), 1),
            }
        )
    return summary


def _values(rows: Sequence[Mapping[str, Any]], column: str) -> list[float]:
    return [float(row[column]) for row in rows if row.get(column) not in (None, "")]
