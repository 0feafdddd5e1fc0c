"""Our figures for the thesis's tables: those of the results on this machine, otherwise those that the documents record.

Each says where it is from and of which regime it is: the thesis's (2DGS: 30,000 iterations at a width of 400 px; SVRaster: 5,000 and
3,000), this project's defaults, or other options, which are then named.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from zeroshop_steps.report.bop import THESIS as PUBLISHED
from zeroshop_steps.report.published.thesis_alike import MODELS, compare_cell, read_settings
from zeroshop_steps.report.reconstruction import AVERAGED, read_cells
from zeroshop_steps.report.site.results_index import Cell, find_runs, find_table, read_facts

THESIS_REGIME, DEFAULTS, RECORDED = "thesis", "defaults", "defaults, recorded"
ITERATIONS: dict[str, dict[str, tuple[int, ...]]] = {
    "2dgs": {THESIS_REGIME: (30_000,), DEFAULTS: (800,)},
    "svraster": {THESIS_REGIME: (5_000, 3_000), DEFAULTS: (400,)},
}
"""Of the regimes, by surface method."""
CellKey = tuple[str, str, str, str]
"""Object, scene, registration and surface method."""
RECORDED_DIFFERS = "images by a ray caster of 1000 x 750 px, training by the defaults"


@dataclass(frozen=True)
class Own:
    """A figure of ours.

    Attributes:
        value: as text.
        regime: as this module describes.
        source: the file or folder that it is from.
        differs: in what, from the published one of its place; empty where in nothing (thesis_alike).
        figures: of a cell, its measures by name.
    """

    value: str
    regime: str
    source: str
    differs: str
    figures: dict[str, float]


@dataclass(frozen=True)
class Scores:
    """The benchmark's table of YCB-V.

    Attributes:
        table: its rows.
        made: the settings that it was made with.
        counts: of how many objects each folder of models is.
        cells: those of the folder of results that it is from.
    """

    table: pd.DataFrame
    made: Mapping[str, Any] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    cells: Mapping[CellKey, Own] = field(default_factory=dict)

    @property
    def instances(self) -> int:
        """In the test images."""
        rows = self.table[(self.table.measure == "instances") & (self.table.object == "")] if len(self.table) else self.table
        return int(rows.value.astype(int).max()) if len(rows) else 0

    def differs(self, models: str) -> tuple[str, ...]:
        """In what the cells of a folder of models differ from the published ones, each once."""
        nvs = models.removeprefix("models_")
        keys = [key for key in self.cells if key[1:] == (MODELS["scene"], MODELS["registration"], nvs)]
        return tuple(dict.fromkeys(self.cells[key].differs for key in keys if self.cells[key].differs)) if keys else ("cells not recorded",)


def find_scores(roots: Iterable[Path], recorded: Path | None) -> Scores:
    """The scores of the first folder of results that has some, otherwise the recorded ones."""
    roots = list(roots)
    table = find_rows(roots, "bop.csv", recorded)
    root = next((root for root in roots if len(find_table(root / "ycbv/tables/bop.csv"))), None)
    if root is None:
        return Scores(table)
    folders = sorted((root / "ycbv/bop").glob("models*"))
    counts = {folder.name: len(read_facts(folder / "models_info.json")) for folder in folders}
    return Scores(table, read_settings(root / "ycbv/tables/bop.csv"), counts, find_cells([root], None))


def find_cells(roots: Iterable[Path], recorded: Path | None) -> dict[CellKey, Own]:
    """The graded cells of YCB-V, each of the first place that has it: the thesis's regime, then others, then the documents."""
    found: dict[CellKey, Own] = {}
    made = [(cell, regime_of(cell)) for root in roots for cell in _list_cells(root / "ycbv")]
    for cell, regime in sorted(made, key=lambda one: one[1] != THESIS_REGIME):
        key = (cell.folder.parents[2].name, cell.scene, cell.registration, cell.nvs)
        differs = "; ".join(compare_cell(cell))
        found.setdefault(key, Own(str(cell.grade), regime, str(cell.folder), differs, cell.figures | _training_seconds(cell)))
    if recorded and (recorded / "reconstruction.csv").is_file():
        for row in read_cells(recorded / "reconstruction.csv", dataset="ycbv").itertuples():
            figures = {name: float(value) for name in AVERAGED if not pd.isna(value := getattr(row, name))}
            key = (row.object, row.scene, row.registration, row.nvs)
            found.setdefault(key, Own(row.grade, RECORDED, "docs/reconstruction.csv", RECORDED_DIFFERS, figures))
    return found


def find_films(roots: Iterable[Path], names: Iterable[str]) -> dict[str, dict[str, bool]]:
    """For every filmed object of these names, whether each surface method made a mesh of it."""
    found: dict[str, dict[str, bool]] = {}
    for root in roots:
        for cell in _list_cells(root / "photos"):
            name = cell.folder.parents[2].name
            if name in names:
                found.setdefault(name, {}).setdefault(cell.nvs, cell.state == "done")
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
    pattern = "obj_*" if dataset.name == "ycbv" else "[!.]*"
    for folder in sorted(dataset.glob(pattern)) if dataset.is_dir() else ():
        for run in find_runs(folder) if not folder.is_symlink() else ():
            yield from (cell for cell in run.cells if cell.state in ("done", "failed"))


def _training_seconds(cell: Cell) -> dict[str, float]:
    seconds = cell.facts["training"].get("cpu_seconds")
    return {"training_cpu_seconds": float(seconds)} if seconds else {}
