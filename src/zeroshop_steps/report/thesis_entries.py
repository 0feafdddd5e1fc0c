"""Every figure of the thesis's Tables 4.1 to 4.6 and its statements in 4.1.2, 4.2 and 4.4, each beside ours and how ours came about.

"ZeroShOP: Zero-shot object pose estimation in unconstrained environments", TU Wien, January 2026. A figure of ours is `reproduced`
where the thesis's own method made it, `substituted` where another one did, which is named, and otherwise `waiting` for what is named.
Marks of failed cells count like all others.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from zeroshop_steps.report.bop import read_published
from zeroshop_steps.report.heights import APART, MAST3R, read_published_heights
from zeroshop_steps.report.reconstruction import read_published_cells
from zeroshop_steps.report.thesis_own import CellKey, Own
from zeroshop_steps.runtime.tables import read_table

REPRODUCED, SUBSTITUTED, WAITING, QUOTED = "reproduced", "substituted", "waiting", "quoted"
STATUSES = (REPRODUCED, SUBSTITUTED, WAITING, QUOTED)
WEIGHTS, GPU, ROBOT, CAPTURES = "weights", "weights, a GPU", "a robot", "the thesis's own films"
TRELLIS = "weights, also those of Trellis, a GPU"
OR_A_RUN = "; a substitute can be made here: snakemake results/ycbv/tables/bop.csv"
GRASPS = Path(__file__).with_name("published_grasps.csv")
STATEMENTS = Path(__file__).with_name("published_statements.csv")
REGISTRATIONS = {
    "thesis: MASt3R-SfM": ("mast3r",),
    "thesis: VGGT (quarter precision)": ("vggt_1024", "vggt"),
    "thesis: VGGT (full precision)": ("vggt_4096",),
}
"""How this project calls the thesis's registrations."""
SUBSTITUTES = {"colmap": "cameras by COLMAP", "aliked": "cameras by ALIKED", "truth": "true cameras"}
"""Registrations that take the place of these, the best substitute first: those that find cameras, then those that are given them."""
SAME_AS_2DGS = ("su_h", "se")
"""Scenes in which SVRaster by MASt3R's cameras has the marks of 2DGS (4.1.1), so that Table 4.2 does not repeat them."""
LEAST_OF_YCBV = 4000
"""Instances in YCB-V's test images of the BOP Challenge, of which there are about 4,100."""
DETECTOR, ESTIMATOR = "contour", "render_compare"
POSES = "poses"  # the measure of a table of grasps that counts them (grasping.py)
OTHER_WEIGHTS = {"foundationpose": "foundationpose_onnx"}
"""The same method with weights that the thesis did not use: a substitute, which is closer than those of other methods."""
MASKS = {"truth": "truth", "cnos": DETECTOR, "sam6d_ism": DETECTOR, "": ""}
LACKING = {"weights": WEIGHTS, "robot": ROBOT, "captures": CAPTURES}


@dataclass(frozen=True)
class Entry:
    """A published figure and ours.

    Attributes:
        table: e.g. "4.1"; row and column: its place there.
        published, ours: as text; ours is empty where there is none.
        ours_true_cameras: of marks, ours from true cameras.
        status: reproduced, substituted, waiting, or quoted: a figure that the thesis took from elsewhere.
        how: by what ours was substituted, or what it waits for.
        regime, source: of ours (thesis_own).
    """

    table: str
    row: str
    column: str
    published: str
    ours: str = ""
    ours_true_cameras: str = ""
    status: str = WAITING
    how: str = ""
    regime: str = ""
    source: str = ""


def list_marks(cells: Mapping[CellKey, Own]) -> list[Entry]:
    """Tables 4.1 and 4.2, and the marks of SVRaster that 4.1.1 says are those of 2DGS."""
    published = read_published_cells()
    same = published[
        (published.registration == "thesis: MASt3R-SfM") & published.scene.isin(SAME_AS_2DGS) & (published.source == "Table 4.1")
    ]
    rows = pd.concat([published, same.assign(nvs="svraster", source="Table 4.2")])
    return [_mark(row, cells) for row in rows.to_dict("records")]


def _mark(row: dict, cells: Mapping[CellKey, Own]) -> Entry:
    names = REGISTRATIONS[row["registration"]]
    title = f"{row['nvs']}, {row['registration'].removeprefix('thesis: ')}, {row['scene']}"
    entry = {"table": row["source"].removeprefix("Table "), "row": title, "column": row["object"], "published": row["grade"]}
    true = cells.get((row["object"], row["scene"], "truth", row["nvs"]))
    entry["ours_true_cameras"] = true.value if true else ""
    for name in (*names, *SUBSTITUTES):
        own = cells.get((row["object"], row["scene"], name, row["nvs"]))
        if own:
            status = REPRODUCED if name in names else SUBSTITUTED
            how = "" if status == REPRODUCED else SUBSTITUTES[name]
            return Entry(**entry, ours=own.value, status=status, how=how, regime=own.regime, source=own.source)
    return Entry(**entry, how=GPU if "full" in row["registration"] else WEIGHTS)


def list_heights(heights: pd.DataFrame) -> list[Entry]:
    """Tables 4.3 and 4.4: the error of each height in per cent. By MASt3R from photos of an object of this name, it is reproduced."""
    found = []
    for known in read_published_heights():
        entry = Entry(known.table, known.name, "difference of the height, %", f"{known.difference_percent:g}", how=CAPTURES)
        rows = heights[heights.difference_percent != ""].to_dict("records") if len(heights) else []
        real = [row for row in rows if row["dataset"] != "ycbv" and row["object"] == known.name and row["how"] == MAST3R]
        rendered = [row for how in (MAST3R, APART) for row in rows if row["object"] == known.ycbv_object != "" and row["how"] == how]
        for row in (real + rendered)[:1]:
            by = "MASt3R" if row["how"] == MAST3R else "printed board"
            how = "" if real else f"{by}, rendered images; the model is {1000 * float(row['height_m']):.1f} mm high"
            entry = replace(
                entry, ours=row["difference_percent"], status=REPRODUCED if real else SUBSTITUTED,
                how=how, regime=row["regime"], source=row["origin"],
            )  # fmt: skip
        found.append(entry)
    return found


def list_scores(scores: pd.DataFrame, real_images: bool) -> list[Entry]:
    """Table 4.5. Figures from the thesis's detectors and estimators on YCB-V's test images are reproduced, all others substituted."""
    counts = scores[(scores.measure == "instances") & (scores.object == "")].value.astype(int) if len(scores) else scores
    instances = int(counts.max()) if len(counts) else 0
    images = f"{instances} instances in {'real' if real_images else 'rendered'} images"
    whole = real_images and instances >= LEAST_OF_YCBV
    found = []
    for row in read_published().to_dict("records"):
        what = {"detection": "AP", "pose": "AR"}[row["task"]]
        masks = f", masks: {row['masks']}" if row["masks"] else ""
        place = (
            "4.5",
            "ground truth" if row["models"] == "models" else row["models"].removeprefix("models_"),
            f"{row['method']}{masks}, {what}",
            row["value"],
        )
        if row["models"] == "official submission":
            found.append(Entry(*place, status=QUOTED, how="scored by BOP"))
            continue
        entry = Entry(*place, how=TRELLIS if row["models"] == "models_trellis" else WEIGHTS + OR_A_RUN)
        other = DETECTOR if row["task"] == "detection" else ESTIMATOR
        masks = row["masks"]
        for method, masked in ((row["method"], masks), (OTHER_WEIGHTS.get(row["method"]), masks), (other, MASKS[masks])):
            same = scores[
                (scores.models == row["models"]) & (scores.method == method) & (scores.masks == masked)
                & (scores.measure == row["measure"]) & (scores.object == "")
            ] if len(scores) else scores  # fmt: skip
            if len(same):
                own = same.iloc[0]
                with_masks = f", masks by {masked}" if masked not in ("", "truth") else ", true masks" if masked else ""
                by = f"{method}{with_masks}, {images}"
                status = REPRODUCED if method == row["method"] and whole else SUBSTITUTED
                entry = Entry(*place, ours=f"{float(own.value):.3f}", status=status, how=by, regime=own.regime, source=own.origin)
                break
        found.append(entry)
    return found


def list_grasps(grasps: pd.DataFrame) -> list[Entry]:
    """Table 4.6 and the success with overlap in 4.4.3: a robot's, or in their place those of a simulated one (report/grasping.py)."""
    found = []
    for row in read_table(GRASPS).to_dict("records"):
        entry = Entry("4.6", row["models"].removeprefix("models_"), row["measure"], row["value"], how=ROBOT)
        delivered = row["models"].replace("models_", "models_delivered_")
        same = grasps[
            (grasps.models == delivered) & (grasps.measure == row["measure"]) & (grasps.object == "")
        ] if len(grasps) else grasps  # fmt: skip
        if len(same):
            own = max(same.to_dict("records"), key=lambda one: float(one["friction"] or 0.0))
            friction = f", friction {own['friction']}" if own["friction"] else ""
            counted = grasps[(grasps.models == delivered) & (grasps.friction == own["friction"]) & (grasps.measure == POSES)]
            poses = next((f", {one.value} poses" for one in counted.itertuples() if one.object == "" and own["friction"]), "")
            how = f"a simulated robot with rendered images of YCB-V objects, {DETECTOR} and {ESTIMATOR}{friction}{poses}"
            entry = replace(entry, ours=own["value"], status=SUBSTITUTED, how=how, regime=own["regime"], source=own["origin"])
        found.append(entry)
    return found


def list_statements(evidence: Mapping[str, tuple[str, str]]) -> list[Entry]:
    """The statements, each with our evidence if there is any: what was found, and where."""
    found = []
    for row in read_table(STATEMENTS).to_dict("records"):
        ours, source = evidence.get(row["evidence"], ("", ""))
        status = SUBSTITUTED if ours else WAITING
        found.append(Entry(row["section"], row["statement"], "", "stated", ours, status=status, how=LACKING[row["lacks"]], source=source))
    return found
