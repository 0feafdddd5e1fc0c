"""The cells of the matrix: those that a user asks for, those that the config chooses, and what is gathered of each."""

import itertools
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from zeroshop_steps import methods
from zeroshop_steps.plan.captures import JOINED_PHOTOS, VIRTUAL_SCENES, WHOLE_SCENE, check_virtual_scene
from zeroshop_steps.plan.datasets import InputFunction, Options, Place, Wildcards
from zeroshop_steps.plan.heights import Heights
from zeroshop_steps.plan.surfaces import NAMED_AFTER
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure

Cell = dict[str, str]
"""The coordinates of a cell: dataset, object, scene, registration and nvs."""


class Cells(Heights):
    """Cells and the axes of tables.

    Attributes:
        without_cameras: the surface methods that need no cameras.
        axes: the methods on each axis of the tables, as `tables` of the config calls it.
    """

    def __init__(self, config: Options, root: Path, *rest: Any) -> None:
        super().__init__(config, root, *rest)
        self.without_cameras = [name for name, method in self.surfaces.items() if not method.registration]
        self.axes = {
            "registrations": methods.REGISTRATIONS,
            "nvs": methods.SURFACES,
            "detectors": self.detectors,
            "estimators": self.estimators,
        }

    def axis(self, axis: str) -> list[str]:
        """The names that the config wants on an axis of the tables."""
        wanted = self.config["tables"][axis]
        if wanted != "all":
            return wanted
        usual = {name: method for name, method in self.axes[axis].items() if not (method.tries or method.given_cameras)}
        return [name for name, method in usual.items() if not methods.lacks(method)]

    def surfaces_with_cameras(self, what: str) -> list[str]:
        """Those of the surface methods in tables whose meshes are finished and measured; `what` asks for them, and needs one."""
        names = [name for name in self.axis("nvs") if name not in self.without_cameras]
        if not names:
            raise StepError(f"tables.nvs: {what} needs a surface method that uses cameras; add one")
        return names

    def measured_surfaces(self, what: str) -> list[str]:
        """Those of them that measure: a generated mesh is a guess."""
        return [name for name in self.surfaces_with_cameras(what) if not self.surfaces[name].generated]

    def say_what_is_left_out(self, *axes: str) -> None:
        """One line, once, on the methods that tables leave out because they cannot run here."""
        if line := methods.left_out(*(self.axes[axis] for axis in axes if self.config["tables"][axis] == "all")):
            self.say(line)

    def cells(
        self,
        dataset: str,
        objects: Iterable[str],
        scenes: list[str] | None = None,
        registrations: list[str] | None = None,
        nvs: list[str] | None = None,
    ) -> list[Cell]:
        """These objects in every combination of the axes, by default those of the config.

        A surface method that needs no cameras has cells of one registration, WITHOUT_CAMERAS, and the others have none of it. Rendered
        films are registered as photos are.
        """
        if self.is_filmed(dataset):
            whole = JOINED_PHOTOS if self.dataset(dataset).get("passes", 1) > 1 else WHOLE_SCENE
            scenes, registrations = scenes or [whole], registrations or [self.config["chosen"]["photos"]["registration"]]
        else:
            self.virtual(dataset, "Tables compare with the truth, which photos lack.")
        if not (registrations and nvs):
            self.say_what_is_left_out("registrations", "nvs")
        wanted = self.config["tables"]["scenes"]
        axes = {
            "object": objects,
            "scene": scenes or (VIRTUAL_SCENES if wanted == "all" else wanted),
            "registration": registrations or [*self.axis("registrations"), methods.WITHOUT_CAMERAS],
            "nvs": nvs or self.axis("nvs"),
        }
        cells = [{"dataset": dataset, **dict(zip(axes, values, strict=True))} for values in itertools.product(*axes.values())]
        without = methods.WITHOUT_CAMERAS
        cells = [cell for cell in cells if (cell["registration"] == without) == (cell["nvs"] in self.without_cameras)]
        if not cells:
            raise StepError(
                f"there is no such cell: {', '.join(self.without_cameras) or 'no surface method'} goes with registration"
                f" {without}, every other surface method with a registration"
            )
        return cells

    def cells_of_object(self, wildcards: Wildcards) -> list[Cell]:
        """One object: every cell of it that the config wants in tables."""
        return self.cells(wildcards.dataset, [self.check_object(wildcards)])

    def cells_of_column(self, wildcards: Wildcards) -> list[Cell]:
        """One column: the cell of these coordinates for every object."""
        column = [wildcards.scene], [wildcards.registration], [wildcards.nvs]
        return self.cells(wildcards.dataset, self.objects(wildcards.dataset), *column)

    def cells_of_table(self, wildcards: Wildcards) -> list[Cell]:
        """One table: every cell that the config wants in it."""
        return self.cells(wildcards.dataset, self.objects(wildcards.dataset))

    def figures_of(self, cells: Callable[[Wildcards], list[Cell]]) -> InputFunction:
        """An input function: the figures of the cells that `cells` gives, each cell whether it failed or not."""
        return lambda wildcards: [f"{self.cell}/cell.csv".format(**cell) for cell in cells(wildcards)]

    def measurements(self, wildcards: Wildcards) -> list[str]:
        """The measurements of a cell, where there is a truth, and its grade, or records of its failure; without cameras, its outcome."""
        if wildcards.registration == methods.WITHOUT_CAMERAS:
            return [f"{self.cell}/outcome.json".format(**wildcards)]
        names = ["quality.csv", "grade.csv"] if self.knows_truth(wildcards.dataset) else ["grade.csv"]
        return [f"{self.cell}/{name}".format(**wildcards) for name in names]

    def has_failed(self, wildcards: Wildcards) -> bool:
        """Whether the mesh of a cell records a failure."""
        return read_failure(Path(f"{self.cell}/mesh.ply".format(**wildcards))) is not None

    # The cell that the config chooses

    def chosen_cell(self, wildcards: Wildcards) -> str:
        """The folder of the cell that the config chooses for an object."""
        self.check_object(wildcards)
        self.usable("nvs method", wildcards.nvs, self.surfaces, "The file is named after the method.")
        return self.cell.format(**{**wildcards, **self.chosen_run(wildcards)})

    def in_chosen_cell(self, *names: str) -> InputFunction:
        """An input function: these files of the chosen cell."""
        return lambda wildcards: [f"{self.chosen_cell(wildcards)}/{name}" for name in names]

    def chosen_cameras(self, wildcards: Wildcards) -> str:
        """The registered photos behind the chosen mesh."""
        return f"{Path(self.chosen_cell(wildcards)).parent}/cameras"

    def of_each_in_photos(self, find: Callable[[Wildcards], str]) -> InputFunction:
        """An input function: what `find` gives for each object that the photos of one were found to show; for that one where none is."""

        def files(wildcards: Wildcards) -> list[str]:
            shown = [
                name for (dataset, name), row in self.photos.items() if (dataset, row["scene_of"]) == (wildcards.dataset, wildcards.object)
            ]
            return [find(Place(**{**wildcards, "object": name})) for name in sorted(shown) or [wildcards.object]]

        return files

    def chosen_quality(self, wildcards: Wildcards) -> list[str]:
        """The quality of the chosen cell, where there is a truth to measure against and cameras that align the mesh with it."""
        measured = self.knows_truth(wildcards.dataset) and self.chosen_run(wildcards)["registration"] != methods.WITHOUT_CAMERAS
        return [f"{self.chosen_cell(wildcards)}/quality.json"] if measured else []

    def in_chosen_cells(self, name: str) -> InputFunction:
        """An input function: this file of the chosen cell of each object of a dataset."""

        def files(wildcards: Wildcards) -> list[str]:
            self.usable("nvs method", wildcards.nvs, self.surfaces, NAMED_AFTER)
            chosen = self.config["chosen"]["virtual"]
            objects = self.objects(wildcards.dataset)
            cells = self.cells(wildcards.dataset, objects, [chosen["scene"]], [chosen["registration"]], [wildcards.nvs])
            return [f"{self.cell}/{name}".format(**cell) for cell in cells]

        return files

    # The models of a dataset

    def true_models(self, wildcards: Wildcards) -> list[str]:
        """The true models of a dataset's objects."""
        self.virtual(wildcards.dataset, "Photos have no true models.")
        return [f"{self.object}/model".format(dataset=wildcards.dataset, object=name) for name in self.objects(wildcards.dataset)]

    def training_captures(self, wildcards: Wildcards) -> list[str]:
        """The captures of a dataset's objects in a scene."""
        check_virtual_scene(wildcards)
        return [f"{Path(model).parent}/{wildcards.scene}/capture" for model in self.true_models(wildcards)]

    def aligned_mesh(self, dataset: str, name: str, models: str) -> list[str]:
        """The alignment of a robot's mesh of an object with the true model; nothing where it is that model, damaged or not."""
        nvs = models.removeprefix("models_delivered_").removeprefix("models_misjudged_")
        cell = {"dataset": dataset, "object": name, "nvs": nvs, **self.config["chosen"]["virtual"]}
        return [] if nvs == models else [f"{self.cell}/aligned.json".format(**cell)]

    def alignment(self, wildcards: Wildcards) -> list[str]:
        """The same for one object."""
        return self.aligned_mesh(wildcards.dataset, wildcards.object, wildcards.models)

    def alignments(self, wildcards: Wildcards) -> list[str]:
        """The same for all objects of a dataset."""
        names = self.objects(wildcards.dataset)
        return [path for name in names for path in self.aligned_mesh(wildcards.dataset, name, wildcards.models)]
