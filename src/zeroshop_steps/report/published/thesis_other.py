"""Figures of ours that are not the published ones: by other methods, images or regimes, in tables of their own with what differs."""

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from zeroshop_steps.methods import TITLES
from zeroshop_steps.report.bop import SHOWN, read_published
from zeroshop_steps.report.grasping import DELIVERED, MISJUDGED
from zeroshop_steps.report.heights import MAST3R, read_published_heights
from zeroshop_steps.report.published.thesis_alike import METHODS, compare_score
from zeroshop_steps.report.published.thesis_own import CellKey, Own, Scores

LEAST_GAP = 0.1
"""Share by which two heights of an object differ that stands in another pose."""


@dataclass(frozen=True)
class Other:
    """A figure of ours of another kind.

    Attributes:
        kind: marks, heights, scores or grasps; row and column: its place there.
        ours: as text.
        differs: in what, from what the thesis published.
        regime, source: as in thesis_own.
    """

    kind: str
    row: str
    column: str
    ours: str
    differs: str
    regime: str
    source: str


def list_other_marks(cells: Mapping[CellKey, Own]) -> list[Other]:
    """The cells that differ in anything, one row a column of the matrix."""
    return [
        Other("marks", f"{nvs}, {TITLES.get(registration, registration)}, {scene}", name, own.value, own.differs, own.regime, own.source)
        for (name, scene, registration, nvs), own in sorted(cells.items(), key=lambda item: (item[0][3], *item[0][2:0:-1], item[0][0]))
        if own.differs
    ]


def list_other_heights(heights: pd.DataFrame) -> list[Other]:
    """Every measured height, but those from films that count as reproduced."""
    published = {(found.ycbv_object or found.name): found for found in read_published_heights()} | {
        found.name: found for found in read_published_heights()
    }
    found = []
    for row in heights.to_dict("records") if len(heights) else []:
        if not row["difference_percent"]:
            continue
        own_m = float(row["height_m"])
        known = published.get(row["object"])
        differs = [
            "rendered images" if row["dataset"] == "ycbv" else "",
            METHODS["mast3r height"] if row["how"] == MAST3R else "a scale of known size",
        ]
        if known is None:
            differs.append("no such object was published")
        elif abs(known.height_m / own_m - 1) > LEAST_GAP:
            differs.append(f"it stands {1000 * own_m:.0f} mm high, the published one {1000 * known.height_m:.0f} mm: another pose")
        words = "; ".join(filter(None, differs))
        found.append(
            Other("heights", f"{row['object']}, {row['how']}", "error, %", row["difference_percent"], words, row["regime"], row["origin"])
        )
    return found


def list_other_scores(scores: Scores) -> list[Other]:
    """The scores of the whole of YCB-V that are not reproduced ones."""
    table, found = scores.table, []
    published = {(row["models"], row["method"], row["masks"]) for row in read_published().to_dict("records")}
    for row in table[table.object == ""].to_dict("records") if len(table) else []:
        if row["measure"] != SHOWN[row["task"]]:
            continue
        differs = compare_score(row, scores.made, scores.instances, scores.counts.get(row["models"]), scores.differs(row["models"]))
        if (row["models"], row["method"], row["masks"]) not in published:
            differs = ("no such column or row was published", *differs)
        if differs:
            models = "ground truth" if row["models"] == "models" else row["models"].removeprefix("models_")
            masks = f", masks: {row['masks']}" if row["masks"] else ""
            column = f"{row['method']}{masks}, {row['measure'].upper()}"
            words = "; ".join(differs)
            found.append(Other("scores", models, column, f"{float(row['value']):.3f}", words, row["regime"], row["origin"]))
    return found


def list_other_grasps(grasps: pd.DataFrame) -> list[Other]:
    """The grasps of a simulated robot, summed over all objects: never a real one's."""
    found = []
    rows = grasps[(grasps.object == "") & (grasps.models != "models")].to_dict("records") if len(grasps) else []
    for row in rows:
        friction = f", friction {row['friction']}" if row["friction"] else ""
        models, wrong = row["models"].removeprefix(DELIVERED), row["models"].startswith(MISJUDGED)
        heights = "heights as wrong as published, of objects that have one" if wrong else "true heights"
        models = f"{models.removeprefix(MISJUDGED)}, wrong heights" if wrong else models
        differs = (
            f"a simulated robot with a hand that floats, on rendered images, with YCB-V's objects, contour and render_compare; {heights}"
        )
        found.append(Other("grasps", f"{models}{friction}", row["measure"], row["value"], differs, row["regime"], row["origin"]))
    return found
