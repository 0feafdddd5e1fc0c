"""Our figures for the thesis's tables: those of the results on this machine, otherwise those that the documents record.

Each says where it is from and of which regime it is: the thesis's (2DGS: 30,000 iterations at a width of 400 px; SVRaster: 5,000 and
3,000), this project's defaults, or other options, which are then named.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from zeroshop_steps.report.bop import THESIS as PUBLISHED
from zeroshop_steps.report.reconstruction import AVERAGED, read_cells
from zeroshop_steps.report.site.results_index import Cell, find_runs, find_table

THESIS_REGIME, DEFAULTS, RECORDED = "thesis", "defaults", "defaults, recorded"
ITERATIONS: dict[str, dict[str, tuple[int, ...]]] = {
    "2dgs": {THESIS_REGIME: (30_000,), DEFAULTS: (800,)},
    "svraster": {THESIS_REGIME: (5_000, 3_000), DEFAULTS: (400,)},
}
"""Of the regimes, by surface method."""
CellKey = tuple[str, str, str, str]
"""Object, scene, registration and surface method."""


@dataclass(frozen=True)
class Own:
    """A figure of ours.

    Attributes:
        value: as text.
        regime: as this module describes.
        source: the file or folder that it is from.
        figures: of a cell, its measures by name.
    """

    value: str
    regime: str
    source: str
    figures: dict[str, float]


def find_cells(roots: Iterable[Path], recorded: Path | None) -> dict[CellKey, Own]:
    """The graded cells of YCB-V, each of the first place that has it: the thesis's regime, then others, then the documents."""
    found: dict[CellKey, Own] = {}
    made = [(cell, regime_of(cell)) for root in roots for cell in _list_cells(root / "ycbv")]
    for cell, regime in sorted(made, key=lambda one: one[1] != THESIS_REGIME):
        key = (cell.folder.parents[2].name, cell.scene, cell.registration, cell.nvs)
        found.setdefault(key, Own(str(cell.grade), regime, str(cell.folder), cell.figures | _training_seconds(cell)))
    if recorded and (recorded / "reconstruction.csv").is_file():
        for row in read_cells(recorded / "reconstruction.csv", dataset="ycbv").itertuples():
            figures = {name: float(value) for name in AVERAGED if not pd.isna(value := getattr(row, name))}
            key = (row.object, row.scene, row.registration, row.nvs)
            found.setdefault(key, Own(row.grade, RECORDED, "docs/reconstruction.csv", figures))
    return found


def regime_of(cell: Cell) -> str:
    """The regime of a cell, by how it was trained."""
    settings = cell.facts["training"].get("settings") or {}
    iterations = settings.get("iterations")
    if iterations is None:
        return "not trained"
    for regime, numbers in ITERATIONS.get(cell.nvs, {}).items():
        if iterations in numbers:
            return regime
    return f"{iterations} iterations"


def find_rows(roots: Iterable[Path], name: str, recorded: Path | None, dataset: str = "ycbv") -> pd.DataFrame:
    """The measured rows of a dataset in one of its tables, such as height.csv, with `regime` and `origin`; none if it is missing."""
    for root in roots:
        table = find_table(root / dataset / "tables" / name)
        if len(table):
            regime = THESIS_REGIME if root.name == THESIS_REGIME else DEFAULTS
            return _own(table, dataset).assign(regime=regime, origin=str(root / dataset / "tables" / name))
    table = find_table(recorded / name) if recorded else pd.DataFrame()
    return _own(table, dataset).assign(regime=RECORDED, origin=f"docs/{name}") if len(table) else table


def _own(table: pd.DataFrame, dataset: str) -> pd.DataFrame:
    kept = table[table.dataset == dataset] if "dataset" in table else table
    return kept[kept.source != PUBLISHED] if "source" in kept else kept


def _list_cells(dataset: Path) -> Iterator[Cell]:
    for folder in sorted(dataset.glob("obj_*")) if dataset.is_dir() else ():
        for run in find_runs(folder) if not folder.is_symlink() else ():
            yield from (cell for cell in run.cells if cell.state in ("done", "failed"))


def _training_seconds(cell: Cell) -> dict[str, float]:
    seconds = cell.facts["training"].get("cpu_seconds")
    return {"training_cpu_seconds": float(seconds)} if seconds else {}
