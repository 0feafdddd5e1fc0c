"""One page with the thesis's Tables 4.1 to 4.6, Figure 4.8 and its statements, each figure beside ours.

It is made of what is there: results on this machine, and for what is missing the figures that the documents record. A CSV beside it
has one row per published figure. See thesis_entries.py for what counts as reproduced.
"""

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import mean

import pandas as pd

from zeroshop_steps.report.heights import APART, THESIS, read_published_heights
from zeroshop_steps.report.site.charts import scatter
from zeroshop_steps.report.site.html import copy_assets, write_page
from zeroshop_steps.report.thesis_entries import (
    STATUSES,
    Entry,
    list_grasps,
    list_heights,
    list_marks,
    list_scores,
    list_statements,
)  # fmt: skip
from zeroshop_steps.report.thesis_own import CellKey, Own, find_cells, find_rows
from zeroshop_steps.runtime.tables import write_table

ORDER = {"none": 0, "sparse": 1, "good": 2}
READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--results", type=Path, nargs="*", default=[], help="folders of results, each with ycbv in it")
    parser.add_argument("--recorded", type=Path, help="folder of recorded tables, such as bop.csv, for what is missing")
    parser.add_argument("--table", type=Path, required=True, help="CSV to write")
    parser.add_argument("--out", type=Path, required=True, help="index.html to write")


def run(args: argparse.Namespace) -> None:
    """Write the table and the page."""
    cells = find_cells(args.results, args.recorded)
    heights = find_rows(args.results, "height.csv", args.recorded)
    real_heights = find_rows(args.results, "height.csv", None, dataset="photos")
    scores = find_rows(args.results, "bop.csv", args.recorded)
    robust = find_rows(args.results, "robustness.csv", args.recorded)
    grasps = find_rows(args.results, "grasp.csv", args.recorded)
    marks = list_marks(cells)
    parts = {
        "4.1 and 4.2": marks,
        "4.3 and 4.4": list_heights(pd.concat([real_heights, heights])),
        "4.5": list_scores(scores, any(has_real_images(root) for root in args.results)),
        "4.6": list_grasps(grasps),
        "statements": list_statements(find_evidence(cells, heights, robust)),
    }
    entries = [entry for part in parts.values() for entry in part]
    write_table(args.table, [asdict(entry) for entry in entries])
    copy_assets(args.out.parent / "assets")
    write_page(
        args.out,
        "thesis.html",
        root="",
        statuses=STATUSES,
        summary=[(name, Counter(entry.status for entry in part), len(part)) for name, part in parts.items()],
        total=Counter(entry.status for entry in entries),
        regimes=Counter(entry.regime for entry in entries if entry.regime),
        mark_tables=make_mark_tables(marks),
        groups=parts,
        figure_4_8=draw_heights(heights),
        short=args.table.name,
    )
    counts = Counter(entry.status for entry in entries)
    print(f"{args.out}: {len(entries)} published figures: " + ", ".join(f"{counts[status]} {status}" for status in STATUSES))


def has_real_images(root: Path) -> bool:
    """Whether YCB-V was tested on BOP's own images: their scenes are links to where they lie, or hold such links."""
    scenes = sorted((root / "ycbv/bop/test").glob("[0-9]*"))
    return bool(scenes) and (scenes[0].is_symlink() or (scenes[0] / "rgb").is_symlink())


def make_mark_tables(marks: Sequence[Entry]) -> list[dict]:
    """For each published row the marks, ours, and how they compare over all cells, failed ones too."""
    rows: dict[tuple[str, str], list[Entry]] = {}
    for entry in marks:
        rows.setdefault((entry.table, entry.row), []).append(entry)
    found = []
    for (table, row), entries in rows.items():
        ours, true = [entry.ours for entry in entries], [entry.ours_true_cameras for entry in entries]
        published = [entry.published for entry in entries]
        hows = " and ".join(dict.fromkeys(entry.how or "the same registration" for entry in entries))
        regimes = " and ".join(dict.fromkeys(entry.regime for entry in entries if entry.regime))
        note = f"{hows}; regime: {regimes}" if any(ours) else f"waiting for {hows}"
        lines = [("published", published), ("ours", ours), ("ours, true cameras", true)]
        counted = [(name, marks, count_good(marks), "" if name == "published" else compare(marks, published)) for name, marks in lines]
        found.append({"table": table, "row": row, "objects": [entry.column for entry in entries], "note": note, "lines": counted})
    return found


def count_good(marks: Sequence[str]) -> str:
    """How many marks are good, of all that are there."""
    there = [mark for mark in marks if mark]
    return f"{there.count('good')} of {len(there)}" if there else ""


def compare(ours: Sequence[str], published: Sequence[str]) -> str:
    """How many of our marks are equal to the published ones or better, of all that are there."""
    pairs = [(ORDER[own], ORDER[theirs]) for own, theirs in zip(ours, published, strict=True) if own]
    return f"{sum(own >= theirs for own, theirs in pairs)} of {len(pairs)}" if pairs else ""


def find_evidence(cells: Mapping[CellKey, Own], heights: pd.DataFrame, robust: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """What our figures say on the statements, and where they are from; a statement on which they say nothing is left out."""
    found = {}
    pairs = []
    for (name, scene, registration, nvs), own in cells.items():
        other = cells.get((name, scene, registration, "svraster"))
        if nvs == "2dgs" and other and "accuracy_mm" in own.figures and "accuracy_mm" in other.figures:
            pairs.append((own, other))
    if pairs:
        sides = [mean(pair[side].figures["accuracy_mm"] for pair in pairs) for side in (0, 1)]
        found["rougher"] = (
            f"holds on rendered images: mean accuracy {sides[0]:.2f} mm by 2DGS and {sides[1]:.2f} mm by SVRaster,"
            f" over {len(pairs)} captures with a mesh by both",
            pairs[0][0].source,
        )
    errors = heights[(heights.how == APART) & (heights.difference_percent != "")] if len(heights) else heights
    if len(errors) > 2:
        percent = errors.difference_percent.astype(float).abs()
        slope = pd.Series(percent.values).corr(pd.Series(errors.height_m.astype(float).values), method="spearman")
        means = "by a printed board on rendered images, which is not a reference-free estimate on real ones"
        found["within"] = (f"largest error {percent.max():.1f} % over {len(errors)} objects, {means}", errors.origin.iloc[0])
        word = "holds" if slope < 0 else "does not hold"
        found["falls"] = (f"{word}: rank correlation of error and height {slope:.2f}, {means}", errors.origin.iloc[0])
    for key, kind in (("scale", "scale"), ("underside", "underside")):
        rows = robust[robust.damage == kind] if len(robust) else robust
        if len(rows):
            steps = "; ".join(f"{row.amount}: {float(row.value):.3f}" for row in rows[rows.measure == "ar"].itertuples())
            found[key] = (f"AR of render_compare with true models, {kind} changed: {steps}", rows.origin.iloc[0])
    return found


def draw_heights(heights: pd.DataFrame) -> str:
    """Figure 4.8: error in per cent over the true height, the thesis's and ours."""
    series = {THESIS: [(found.height_m, abs(found.difference_percent), found.name) for found in read_published_heights()]}
    for row in heights.to_dict("records"):
        if row["difference_percent"]:
            series.setdefault(row["how"], []).append((float(row["height_m"]), abs(float(row["difference_percent"])), row["object"]))
    return scatter(series, "true height in m", "error of the measured height in %", trend=True)
