"""Every figure of the thesis's Tables 4.1 to 4.6 and its statements in 4.1, 4.2 and 4.4, and ours where it is the same figure.

"ZeroShOP: Zero-shot object pose estimation in unconstrained environments", TU Wien, January 2026. A figure of ours is `reproduced`
where it differs from the published one in nothing that thesis_alike compares: dataset, images, count, registration, regime and inputs.
Where the thesis's method made it and something differs, the status is `differs`, and ours stands in a table of its own kind
(thesis_other), as figures of all other methods do. Otherwise it is `waiting` for what is named. Marks of failed cells count like others.
In a rehearsal, whose networks know nothing, every figure that the thesis's method made stands in its place, as `rehearsed`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from zeroshop_steps.report.bop import read_published
from zeroshop_steps.report.heights import MAST3R, read_published_heights
from zeroshop_steps.report.published.thesis_alike import METHODS, compare_score
from zeroshop_steps.report.published.thesis_own import CellKey, Own, Scores
from zeroshop_steps.report.published.thesis_plan import REGISTRATIONS
from zeroshop_steps.report.reconstruction import read_published_cells
from zeroshop_steps.runtime.tables import read_table

REPRODUCED, REHEARSED, DIFFERS, WAITING, QUOTED = "reproduced", "rehearsed", "differs", "waiting", "quoted"
STATUSES = (REPRODUCED, REHEARSED, DIFFERS, WAITING, QUOTED)
REHEARSAL = "rehearsal"
"""The regime of all figures of one."""
WEIGHTS, GPU, ROBOT, CAPTURES = "weights", "weights, a GPU", "a robot", "the thesis's own films"
TRELLIS = "weights, also those of Trellis, a GPU"
GRASPS = Path(__file__).with_name("published_grasps.csv")
STATEMENTS = Path(__file__).with_name("published_statements.csv")
LACKING = {"weights": WEIGHTS, "robot": ROBOT, "captures": CAPTURES}


@dataclass(frozen=True)
class Entry:
    """A published figure, and ours if it is the same one.

    Attributes:
        table: e.g. "4.1"; row and column: its place there.
        published, ours: as text; ours is empty where it is neither reproduced nor rehearsed. Of statements, what our figures say.
        status: one of STATUSES; quoted: a figure that the thesis took from elsewhere.
        how: in what ours differs, or what it waits for.
        regime, source: of ours (thesis_own).
    """

    table: str
    row: str
    column: str
    published: str
    ours: str = ""
    status: str = WAITING
    how: str = ""
    regime: str = ""
    source: str = ""


def _enter(place: tuple[str, str, str, str], ours: str, differs: str, regime: str, source: str, rehearsal: bool) -> Entry:
    """A published figure for which the thesis's method made one of ours, which differs in this or, where it is empty, in nothing."""
    if rehearsal:
        return Entry(*place, ours=ours, status=REHEARSED, how=differs, regime=REHEARSAL, source=source)
    if differs:
        return Entry(*place, status=DIFFERS, how=differs, regime=regime, source=source)
    return Entry(*place, ours=ours, status=REPRODUCED, regime=regime, source=source)


def list_marks(cells: Mapping[CellKey, Own], rehearsal: bool = False) -> list[Entry]:
    """Tables 4.1 and 4.2."""
    return [_mark(row, cells, rehearsal) for row in read_published_cells().to_dict("records")]


def _mark(row: dict, cells: Mapping[CellKey, Own], rehearsal: bool) -> Entry:
    registration = row["registration"].removeprefix("thesis: ")
    title = f"{row['nvs']}, {registration}, {row['scene']}"
    place = (row["source"].removeprefix("Table "), title, row["object"], row["grade"])
    own = cells.get((row["object"], row["scene"], REGISTRATIONS[registration], row["nvs"]))
    if own is None:
        return Entry(*place, how=GPU if "full" in registration else WEIGHTS)
    return _enter(place, own.value, own.differs, own.regime, own.source, rehearsal)


def list_heights(heights: pd.DataFrame, rehearsal: bool = False) -> list[Entry]:
    """Tables 4.3 and 4.4: the error of each height in per cent, by MASt3R from films of an object of this name."""
    rows = heights[heights.difference_percent != ""].to_dict("records") if len(heights) else []
    made = {row["object"]: row for row in rows if row["dataset"] != "ycbv" and row["how"] == MAST3R}
    found = []
    for known in read_published_heights():
        place = (known.table, known.name, "difference of the height, %", f"{known.difference_percent:g}")
        row = made.get(known.name)
        if row is None:
            found.append(Entry(*place, how=CAPTURES))
        else:
            how = METHODS["mast3r height"]
            found.append(_enter(place, row["difference_percent"], how, row["regime"], row["origin"], rehearsal))
    return found


def list_scores(scores: Scores, rehearsal: bool = False) -> list[Entry]:
    """Table 4.5."""
    table, found = scores.table, []
    for row in read_published().to_dict("records"):
        what = {"detection": "AP", "pose": "AR"}[row["task"]]
        masks = f", masks: {row['masks']}" if row["masks"] else ""
        models = "ground truth" if row["models"] == "models" else row["models"].removeprefix("models_")
        place = ("4.5", models, f"{row['method']}{masks}, {what}", row["value"])
        if row["models"] == "official submission":
            found.append(Entry(*place, status=QUOTED, how="scored by BOP"))
            continue
        run = table[
            (table.models == row["models"]) & (table.method == row["method"]) & (table.masks == row["masks"]) & (table.object == "")
        ] if len(table) else table  # fmt: skip
        same = run[run.measure == row["measure"]] if len(run) else run
        if not len(same):
            failed = list(run[run.measure == "failed"].value) if len(run) else []
            how = failed[0] if failed else TRELLIS if row["models"] == "models_trellis" else WEIGHTS
            found.append(Entry(*place, how=how))
            continue
        own = same.iloc[0]
        differs = compare_score(row, scores.made, scores.instances, scores.counts.get(row["models"]), scores.differs(row["models"]))
        found.append(_enter(place, f"{float(own.value):.3f}", "; ".join(differs), own.regime, own.origin, rehearsal))
    return found


def list_grasps() -> list[Entry]:
    """Table 4.6 and the success with overlap in 4.4.3: a real robot's."""
    rows = read_table(GRASPS).to_dict("records")
    return [Entry("4.6", row["models"].removeprefix("models_"), row["measure"], row["value"], how=ROBOT) for row in rows]


def list_statements(evidence: Mapping[str, tuple[str, str]], rehearsal: bool = False) -> list[Entry]:
    """The statements, each with our evidence if there is any: what was found, and where."""
    found = []
    for row in read_table(STATEMENTS).to_dict("records"):
        ours, source = evidence.get(row["evidence"], ("", ""))
        status = (REHEARSED if rehearsal else DIFFERS) if ours else WAITING
        found.append(Entry(row["section"], row["statement"], "", "stated", ours, status=status, how=LACKING[row["lacks"]], source=source))
    return found
