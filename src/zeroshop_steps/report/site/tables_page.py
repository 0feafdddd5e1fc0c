"""The page of tables: grades, figures, heights and poses, with the published values of the thesis beside them.

Tables 4.1 to 4.5 and Figure 4.8 are those of the diploma thesis ("ZeroShOP: Zero-shot object pose estimation in unconstrained
environments", TU Wien, January 2026).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from zeroshop_steps.report import bop
from zeroshop_steps.report.heights import THESIS, read_published_heights
from zeroshop_steps.report.reconstruction import read_published_cells
from zeroshop_steps.report.site.html import make_link, write_page
from zeroshop_steps.report.site.results_index import find_table
from zeroshop_steps.report.site.svg_plots import scatter
from zeroshop_steps.runtime.files import atomic_directory
from zeroshop_steps.runtime.tables import write_table

SCENE_ORDER = ("su_l", "su_h", "se", "video")
FIGURES = (
    ("accuracy_mm", "accuracy mm"),
    ("completeness_mm", "completeness mm"),
    ("f_score_1_percent", "F-score 1 %"),
    ("normal_error_deg", "normals °"),
    ("psnr_db", "PSNR dB"),
    ("scale_error_percent", "scale error %"),
    ("silhouette_agreement", "silhouettes"),
    ("photometric_error", "colours"),
)


def write_tables(folder: Path, cards: Sequence[dict], dataset: str, tables: Path | None) -> None:
    """Write tables.html and downloads/*.csv.

    Args:
        folder: of the report; cards: what the gallery knows of each object; dataset: its name.
        tables: the dataset's tables; those that are missing are left out.
    """
    found = {path.stem: find_table(path) for path in sorted(tables.glob("*.csv"))} if tables and tables.is_dir() else {}
    heights, scores = (found.get(name, pd.DataFrame()) for name in ("height", "bop"))
    measured = scores[scores.source != bop.THESIS] if len(scores) else scores
    thesis = list(read_published_cells().itertuples()) if dataset == "ycbv" else []
    height_rows = make_height_rows(heights)
    content: dict[str, Any] = {
        "grades": make_grade_tables(cards, thesis),
        "figures": make_figure_rows(cards),
        "columns": list_used_columns(cards),
        "heights": height_rows,
        "height_columns": list_used_height_columns(heights),
        "figure_4_8": draw_height_plot(heights),
        "plots": draw_plots(cards),
        "bop": bop.summarize_models(measured) if len(measured) else [],
        "bop_objects": bop.summarize_objects(measured) if len(measured) else [],
        "bop_links": {str(card["number"]): {"name": card["name"], "link": card["page"]} for card in cards if card["number"]},
        "published_bop": bop.summarize_models(bop.read_published()),
    }
    downloads: dict[str, pd.DataFrame | list[dict]] = {
        "grades": make_grade_csv(cards, thesis),
        "figures": make_figure_csv(cards),
        "heights": height_rows,
    }
    downloads |= {name: table for name, table in found.items() if name not in downloads} | {"published_bop": bop.read_published()}
    downloads = {name: table for name, table in downloads.items() if len(table)}
    with atomic_directory(folder / "downloads") as place:
        for name, table in downloads.items():
            write_table(place / f"{name}.csv", table)
    names = {card["object"]: card["name"] for card in cards}
    write_page(
        folder / "tables.html", "tables.html", dataset=dataset, cards=cards, names=names, downloads=set(downloads), root="", **content
    )


def make_grade_tables(cards: Sequence[dict], thesis: Sequence) -> list[dict]:
    """The grades as in Tables 4.1 and 4.2: for each surface method a row per registration and scene, ours and published."""
    objects = [card["object"] for card in cards]
    ours = [(cell["nvs"], cell["registration"], cell["scene"], card, cell) for card in cards for cell in card["cells"]]
    found = []
    for nvs in dict.fromkeys([*(row[0] for row in ours), *(cell.nvs for cell in thesis)]):
        rows: dict[tuple[str, str], dict] = {}
        for _, registration, scene, card, cell in (row for row in ours if row[0] == nvs):
            row = rows.setdefault((registration, scene), {"registration": registration, "scene": scene, "thesis": False, "cells": {}})
            row["cells"][card["object"]] = cell | {"link": make_link(card["page"], cell["key"])}
        for cell in (cell for cell in thesis if cell.nvs == nvs and cell.object in objects):
            key = (cell.registration, cell.scene)
            row = rows.setdefault(key, {"registration": cell.registration, "scene": cell.scene, "thesis": True, "cells": {}})
            row["cells"][cell.object] = {"grade": cell.grade, "state": "done", "link": None}
        ordered = sorted(rows.values(), key=lambda row: (row["thesis"], row["registration"], _order(row["scene"])))
        for row in ordered:
            row["counts"] = {grade: sum(cell["grade"] == grade for cell in row["cells"].values()) for grade in ("good", "sparse", "none")}
        found.append({"nvs": nvs, "rows": ordered})
    return found


def make_figure_rows(cards: Sequence[dict]) -> list[dict]:
    """The figures of every cell, one row per cell."""
    return [{"card": card, "cell": cell, "link": make_link(card["page"], cell["key"])} for card in cards for cell in card["cells"]]


def list_used_columns(cards: Sequence[dict]) -> list[tuple[str, str]]:
    """The figures that at least one cell has."""
    there = {name for card in cards for cell in card["cells"] for name in cell["figures"]}
    return [column for column in FIGURES if column[0] in there]


def make_height_rows(measured: pd.DataFrame) -> list[dict]:
    """The measured heights beside the published ones; the published ones only if none were measured."""
    if len(measured):
        return measured.to_dict("records")
    columns = {"published_height_m": "height_m", "published_measured_height_m": "measured_height_m"}
    columns |= {"published_difference_percent": "difference_percent"}
    return [
        {"how": THESIS, "object": found.ycbv_object, "published_name": found.name}
        | {to: getattr(found, name) for to, name in columns.items()}
        for found in read_published_heights()
    ]


def list_used_height_columns(measured: pd.DataFrame) -> list[tuple[str, str]]:
    """The columns of the table of heights; our own only if something was measured."""
    own = [("height_m", "true height m"), ("measured_height_m", "measured m"), ("difference_percent", "difference %")]
    published = [("published_name", "published name"), ("published_height_m", "published height m")]
    published += [("published_measured_height_m", "published, MASt3R m"), ("published_difference_percent", "published difference %")]
    return (own if len(measured) else []) + published


def draw_height_plot(measured: pd.DataFrame) -> Markup:
    """Figure 4.8: error in per cent over the true height, the thesis's and ours."""
    series = {THESIS: [(found.height_m, abs(found.difference_percent), found.name) for found in read_published_heights()]}
    for row in measured.itertuples():
        if row.difference_percent:
            series.setdefault(row.how, []).append((float(row.height_m), abs(float(row.difference_percent)), row.object))
    return scatter(series, "true height in m", "error of the measured height in %", trend=True)


def draw_plots(cards: Sequence[dict]) -> list[dict]:
    """Plots of the figures: completeness over accuracy, and PSNR over F-score."""
    wanted = (
        ("Exact and complete", "accuracy_mm", "completeness_mm", "accuracy in mm", "completeness in mm"),
        ("Shape and looks", "f_score_1_percent", "psnr_db", "F-score at 1 % of the diameter", "PSNR in dB"),
    )
    found = []
    for title, x, y, x_label, y_label in wanted:
        series: dict[str, list] = {}
        for card in cards:
            for cell in (cell for cell in card["cells"] if x in cell["figures"] and y in cell["figures"]):
                name = f"{cell['nvs']}, {cell['scene']}, {cell['registration']}"
                series.setdefault(name, []).append((cell["figures"][x], cell["figures"][y], card["name"]))
        if series:
            found.append({"title": title, "plot": scatter(series, x_label, y_label, from_zero=x == "accuracy_mm")})
    return found


def make_grade_csv(cards: Sequence[dict], thesis: Sequence) -> list[dict]:
    """All grades, ours and published, as a tidy table."""
    rows = [
        {"source": "this run", "object": card["object"], **{axis: cell[axis] for axis in ("scene", "registration", "nvs", "state")}}
        | {"grade": cell["grade"] or "", "reason": "; ".join(cell["reasons"])}
        for card in cards
        for cell in card["cells"]
    ]
    for cell in thesis:
        axes = {axis: getattr(cell, axis) for axis in ("object", "scene", "registration", "nvs", "grade")}
        rows.append({"source": "thesis", **axes, "state": "done", "reason": ""})
    return rows


def make_figure_csv(cards: Sequence[dict]) -> list[dict]:
    """All measurements as a tidy table."""
    return [
        {"object": card["object"], **{axis: cell[axis] for axis in ("scene", "registration", "nvs")}, "measure": name, "value": value}
        for card in cards
        for cell in card["cells"]
        for name, value in cell["figures"].items()
    ]


def _order(scene: str) -> int:
    return SCENE_ORDER.index(scene) if scene in SCENE_ORDER else len(SCENE_ORDER)
