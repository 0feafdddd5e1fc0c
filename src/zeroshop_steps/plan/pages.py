"""What the pages of a dataset's report, and that of the thesis, are made of."""

import shlex
from collections.abc import Iterable, Iterator
from pathlib import Path

from zeroshop_steps import methods
from zeroshop_steps.networks.weights import read_table
from zeroshop_steps.plan.captures import WHOLE_SCENE
from zeroshop_steps.plan.cells import Cell
from zeroshop_steps.plan.datasets import Wildcards
from zeroshop_steps.plan.tables import Tables
from zeroshop_steps.report.published import thesis_plan
from zeroshop_steps.runtime.config_files import config_changes


def stamp_files(paths: Iterable[Path]) -> list[str]:
    """Files with their times: a parameter, so that a page is made again when these change."""
    return [f"{path} {path.stat().st_mtime_ns}" for path in sorted(paths)]


class Pages(Tables):
    """Inputs and settings of pages."""

    def cells_of_page(self, wildcards: Wildcards) -> list[Cell]:
        """The cells of an object that are made for its page: the chosen ones, all, or none (the page then shows what exists)."""
        self.check_object(wildcards)
        if self.config["report"]["cells"] == "present":
            return []
        if not self.is_virtual(wildcards.dataset):
            cell = {"dataset": wildcards.dataset, "object": wildcards.object, **self.chosen_run(wildcards)}
            return [{**cell, "nvs": nvs} for nvs in self.surfaces_with_cameras("the report")]
        if self.config["report"]["cells"] == "all":
            return self.cells_of_object(wildcards)
        chosen = self.config["chosen"]["virtual"]
        return self.cells(wildcards.dataset, [wildcards.object], [chosen["scene"]], [chosen["registration"]])

    def parts_of_page(self, wildcards: Wildcards) -> list[str]:
        """How each of these cells ended: its measurements, or of the user's own photos its mesh and grade; or the record of its failure."""
        names = ("cell.csv",) if self.is_virtual(wildcards.dataset) else ("mesh.ply", "grade.json")
        return [f"{self.cell}/{name}".format(**cell) for cell in self.cells_of_page(wildcards) for name in names]

    def other_cells(self, wildcards: Wildcards) -> list[str]:
        """Files of other cells, stamped."""
        folder = Path(self.object.format(**wildcards))
        asked = {self.cell.format(**cell) for cell in self.cells_of_page(wildcards)}
        made = (path for name in ("outcome.json", "mesh.ply", "grade.json") for path in folder.glob(f"*/*/*/{name}"))
        return stamp_files(path for path in made if str(path.parent) not in asked)

    def first_shown(self, wildcards: Wildcards) -> str:
        """The scene and registration that the page shows first."""
        chosen = self.chosen_run(wildcards)
        return f"{chosen['scene']}/{chosen['registration']}"

    def changes_option(self, defaults: Path) -> str:
        """The option that tells the page with which changes of the config its cells were made."""
        changes = config_changes(self.given, defaults, ignored=("targets", "tables", "report", "chosen"))
        return f"--config {' '.join(map(shlex.quote, changes))}" if changes else ""

    def pages(self, wildcards: Wildcards) -> list[str]:
        """The page of every object of the dataset."""
        return [f"{self.report}/objects/{name}".format(**wildcards) for name in self.objects(wildcards.dataset)]

    def tables_there(self, wildcards: Wildcards) -> list[str]:
        """The dataset's tables on disk, stamped: the report shows those that are there."""
        return stamp_files(Path(self.tables.format(**wildcards)).glob("*.csv"))

    # The thesis

    def _cells_of_models(self, chosen: dict[str, str], surfaces: list[str]) -> list[Cell]:
        return [{"object": name, "nvs": nvs, **chosen} for name in self.objects("ycbv") for nvs in surfaces]

    def say_what_the_thesis_takes(self) -> None:
        """Hours and GB of what was published, and which weights and films are not there: once, before anything runs."""
        of_models = self._cells_of_models(self.config["chosen"]["virtual"], self.axis("nvs"))
        marks = thesis_plan.list_marks(self.objects("ycbv"))
        cells = {tuple(sorted(cell.items())): cell for cell in (*marks, *of_models)}
        named = [methods.REGISTRATIONS[name] for name in {cell["registration"] for cell in cells.values()}]
        for axis, own in (("nvs", self.surfaces), ("detectors", self.detectors), ("estimators", self.estimators)):
            named += map(own.__getitem__, self.axis(axis))
        files = {file for method in (*named, self.heights["mast3r"]) for file in method.files}
        missing = sorted(file for file in files if not (methods.WEIGHTS_FOLDER / file).is_file())
        known = read_table()
        mb = sum((known[file].size_bytes or 0) / 1e6 for file in missing if file in known)
        self.say(thesis_plan.say_costs(cells.values(), mb, self.has_real_tests("ycbv")))
        if missing:
            self.say(f"Cells of these become failed ones unless `snakemake weights` fetches them before: {', '.join(missing)}")
        films = self.objects("photos")
        if absent := [name for name in films if name not in self.list_filmed(films)]:
            self.say(f"Left out, as {self.config['objects_table']} names films or photos that are not there: {', '.join(absent)}")

    def figures_of_thesis(self, wildcards: Wildcards) -> list[str]:
        """What the thesis published of YCB-V and of its films, if the config asks for it; otherwise what is there is shown."""
        if self.config["thesis"]["make"] == "present":
            return []
        self.say_what_the_thesis_takes()
        # The cells of the models of Table 4.5 are graded, too: what differs in them differs in its scores.
        of_models = self._cells_of_models(thesis_plan.OF_MODELS, self.surfaces_with_cameras("Table 4.5"))
        cells = [{"dataset": "ycbv", **cell} for cell in (*thesis_plan.list_marks(self.objects("ycbv")), *of_models)]
        films, surfaces = self.list_filmed(self.objects("photos")), self.measured_surfaces("the table of films")
        run = {"dataset": "photos", "scene": WHOLE_SCENE, "registration": self.config["chosen"]["photos"]["registration"]}
        cells += [{**run, "object": name, "nvs": nvs} for name in films for nvs in surfaces]
        tables = [("photos", "height")] if films else []
        tables += [("ycbv", "bop"), ("ycbv", "grasp")]
        figures = dict.fromkeys(f"{self.cell}/cell.csv".format(**cell) for cell in cells)
        return [*figures, *(f"{self.tables}/{name}.csv".format(dataset=dataset) for dataset, name in tables)]

    def results_of_thesis(self, wildcards: Wildcards) -> list[str]:
        """Folders with results of YCB-V or of films: those of this config, and others beside or below them."""
        roots = dict.fromkeys([Path(self.config["results"]), Path("results"), *sorted(Path("results").glob("*"))])
        return [str(root) for root in roots if (root / "ycbv").is_dir() or (root / "photos").is_dir()]

    def thesis_there(self, wildcards: Wildcards) -> list[str]:
        """Results of YCB-V, stamped."""
        return stamp_files(self._find_thesis(wildcards))

    def _find_thesis(self, wildcards: Wildcards) -> Iterator[Path]:
        for root in map(Path, self.results_of_thesis(wildcards)):
            for name in ("ycbv", "photos"):
                for place in ("*/*/*/*/outcome.json", "*/*/*/*/grade.json", "tables/*.csv"):
                    yield from (root / name).glob(place)
