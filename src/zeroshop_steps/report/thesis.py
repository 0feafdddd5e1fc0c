"""One page with the thesis's Tables 4.1 to 4.6, Figure 4.8 and its statements, each figure beside ours.

Beside a published figure stands only the same one (thesis_entries); all others of ours stand below, in tables of their own kind with what
differs (thesis_other): from results on this machine, and for what is missing from the figures that the documents record. A CSV has
one row per published figure, another one a row per figure of another kind.
"""

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from statistics import mean

import pandas as pd

from zeroshop_steps.report.bop import SHOWN
from zeroshop_steps.report.heights import APART, THESIS, read_published_heights
from zeroshop_steps.report.published.thesis_entries import (
    DIFFERS,
    REHEARSAL,
    REHEARSED,
    REPRODUCED,
    STATUSES,
    WAITING,
    Entry,
    list_grasps,
    list_heights,
    list_marks,
    list_scores,
    list_statements,
)  # fmt: skip
from zeroshop_steps.report.published.thesis_other import Other, list_other_grasps, list_other_heights, list_other_marks, list_other_scores
from zeroshop_steps.report.published.thesis_own import CellKey, Own, find_cells, find_films, find_rows, find_scores
from zeroshop_steps.report.reconstruction import read_published_cells
from zeroshop_steps.report.site.html import copy_assets, write_page
from zeroshop_steps.report.site.svg_plots import scatter
from zeroshop_steps.runtime.tables import write_table

SAME_AS_2DGS = ("su_h", "se")
"""Scenes in which SVRaster by MASt3R's cameras has the marks of 2DGS (4.1.1), so that Table 4.2 does not repeat them."""
ORDER = {"none": 0, "sparse": 1, "good": 2}
READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--results", type=Path, nargs="*", default=[], help="folders of results, each with ycbv in it")
    parser.add_argument("--recorded", type=Path, help="folder of recorded tables, such as bop.csv, for what is missing")
    parser.add_argument("--rehearsal", action="store_true", help="the networks know nothing: mark all figures, none counts as reproduced")
    parser.add_argument("--table", type=Path, required=True, help="CSV to write")
    parser.add_argument("--other-table", type=Path, required=True, help="CSV to write of our figures of another kind")
    parser.add_argument("--out", type=Path, required=True, help="index.html to write")


def run(args: argparse.Namespace) -> None:
    """Write the table and the page."""
    cells = find_cells(args.results, args.recorded)
    heights = find_rows(args.results, "height.csv", args.recorded)
    real_heights = find_rows(args.results, "height.csv", None, dataset="photos")
    scores = find_scores(args.results, args.recorded)
    robust = find_rows(args.results, "robustness.csv", args.recorded)
    grasps = find_rows(args.results, "grasp.csv", args.recorded)
    compared = {name: find_rows(args.results, f"{name}.csv", None) for name in ("detectors", "estimators")}
    films = find_films(args.results, {known.name for known in read_published_heights()})
    marks, both_heights = list_marks(cells, args.rehearsal), pd.concat([real_heights, heights])
    parts = {
        "4.1 and 4.2": marks,
        "4.3 and 4.4": list_heights(both_heights, args.rehearsal),
        "4.5": list_scores(scores, args.rehearsal),
        "4.6": list_grasps(),
        "statements": list_statements(find_evidence(cells, heights, robust, films) | find_comparisons(compared), args.rehearsal),
    }
    entries = [entry for part in parts.values() for entry in part]
    others = {
        "marks": list_other_marks(cells),
        "heights": list_other_heights(both_heights),
        "scores": list_other_scores(scores),
        "grasps": list_other_grasps(grasps),
    }
    if args.rehearsal:
        others = {kind: [replace(other, regime=REHEARSAL) for other in part] for kind, part in others.items()}
    statuses = [status for status in STATUSES if (status != REPRODUCED if args.rehearsal else status != REHEARSED)]
    write_table(args.table, [asdict(entry) for entry in entries])
    write_table(args.other_table, [asdict(other) for part in others.values() for other in part], [one.name for one in fields(Other)])
    copy_assets(args.out.parent / "assets")
    write_page(
        args.out,
        "thesis.html",
        root="",
        statuses=statuses,
        rehearsal=args.rehearsal,
        summary=[(name, Counter(entry.status for entry in part), len(part)) for name, part in parts.items()],
        total=Counter(entry.status for entry in entries),
        regimes=Counter(entry.regime for entry in entries if entry.regime),
        mark_tables=make_mark_tables(marks),
        other_marks=make_other_marks(others["marks"]),
        groups=parts,
        others=others,
        figure_4_8=draw_heights(heights),
        short=args.table.name,
        other_short=args.other_table.name,
    )
    counts = Counter(entry.status for entry in entries)
    print(f"{args.out}: {len(entries)} published figures: " + ", ".join(f"{counts[status]} {status}" for status in statuses))


def make_mark_tables(marks: Sequence[Entry]) -> list[dict]:
    """For each published row the marks, ours where reproduced or rehearsed, and how they compare over all cells, failed ones too."""
    rows: dict[tuple[str, str], list[Entry]] = {}
    for entry in marks:
        rows.setdefault((entry.table, entry.row), []).append(entry)
    found = []
    for (table, row), entries in rows.items():
        ours, published = [entry.ours for entry in entries], [entry.published for entry in entries]
        statuses = Counter(entry.status for entry in entries)
        words = {
            REPRODUCED: "reproduced",
            REHEARSED: "rehearsed",
            DIFFERS: "made, but not alike (below)",
            WAITING: f"waiting for {entries[-1].how}",
        }
        note = ", ".join(f"{statuses[status]} {text}" for status, text in words.items() if statuses[status])
        lines = [("published", published), ("ours", ours)]
        counted = [
            (name, marks, count_good(marks), "" if name == "published" or statuses[REHEARSED] else compare(marks, published))
            for name, marks in lines
        ]
        found.append({"table": table, "row": row, "objects": [entry.column for entry in entries], "note": note, "lines": counted})
    return found


def make_other_marks(others: Sequence[Other]) -> list[dict]:
    """For each of our rows of another kind the marks of the 21 objects, and in what they differ, each text once."""
    rows: dict[str, list[Other]] = {}
    for other in others:
        rows.setdefault(other.row, []).append(other)
    objects = sorted(read_published_cells().object.unique())
    found = []
    for row, own in rows.items():
        marks = {other.column: other.ours for other in own}
        differs = " / ".join(dict.fromkeys(other.differs for other in own))
        sources = " and ".join(dict.fromkeys(other.regime for other in own))
        shown = [marks.get(name, "") for name in objects]
        found.append({"row": row, "objects": objects, "marks": shown, "good": count_good(shown), "differs": differs, "regime": sources})
    return found


def count_good(marks: Sequence[str]) -> str:
    """How many marks are good, of all that are there."""
    there = [mark for mark in marks if mark]
    return f"{there.count('good')} of {len(there)}" if there else ""


def compare(ours: Sequence[str], published: Sequence[str]) -> str:
    """How many of our marks are equal to the published ones or better, of all that are there."""
    pairs = [(ORDER[own], ORDER[theirs]) for own, theirs in zip(ours, published, strict=True) if own]
    return f"{sum(own >= theirs for own, theirs in pairs)} of {len(pairs)}" if pairs else ""


def find_evidence(
    cells: Mapping[CellKey, Own], heights: pd.DataFrame, robust: pd.DataFrame, films: Mapping[str, Mapping[str, bool]]
) -> dict[str, tuple[str, str]]:
    """What our figures say on the statements, and where they are from; a statement on which they say nothing is left out."""
    found = {}
    if films:
        whole = [name for name, made in films.items() if made.get("2dgs") and made.get("svraster")]
        rest = sorted(set(films) - set(whole))
        words = f"{len(whole)} of {len(films)} filmed objects have meshes by both" + (f"; not {', '.join(rest)}" if rest else "")
        found["films"] = (words, "results of photos")
    alike = [
        (own.value, other.value)
        for (name, scene, registration, nvs), own in cells.items()
        if registration == "mast3r" and nvs == "2dgs" and scene in SAME_AS_2DGS
        and (other := cells.get((name, scene, registration, "svraster")))
    ]  # fmt: skip
    if alike:
        found["same"] = (f"{sum(one == other for one, other in alike)} of {len(alike)} marks are the same", "the cells of mast3r")
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


def find_comparisons(tables: Mapping[str, pd.DataFrame]) -> dict[str, tuple[str, str]]:
    """What the tables of 4.4.1 (detectors) and 4.4.2 (estimators) say: the score of each method with each set of models."""
    found = {}
    for name, table in tables.items():
        shown = table[table.measure.isin(SHOWN.values()) & (table.object == "")] if len(table) else table
        if len(shown):
            parts = []
            for models, rows in shown.groupby("models", sort=False):
                scores = ", ".join(f"{row.method} {float(row.value):.3f}" for row in rows.itertuples())
                known = "ground truth" if models == "models" else str(models).removeprefix("models_").replace("_", " ")
                parts.append(f"{known}: {scores}")
            found[name] = (f"{shown.measure.iloc[0].upper()}, {'; '.join(parts)}", shown.origin.iloc[0])
    return found


def draw_heights(heights: pd.DataFrame) -> str:
    """Figure 4.8: error in per cent over the true height, the thesis's and ours."""
    series = {THESIS: [(found.height_m, abs(found.difference_percent), found.name) for found in read_published_heights()]}
    for row in heights.to_dict("records"):
        if row["difference_percent"]:
            series.setdefault(row["how"], []).append((float(row["height_m"]), abs(float(row["difference_percent"])), row["object"]))
    return scatter(series, "true height in m", "error of the measured height in %", trend=True)
