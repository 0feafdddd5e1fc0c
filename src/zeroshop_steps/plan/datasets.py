"""The datasets of the config and their objects, and where results of them lie."""

import functools
import os
import shlex
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from zeroshop_steps import methods
from zeroshop_steps.methods import Method
from zeroshop_steps.plan.step_options import complete_sections
from zeroshop_steps.runtime.config_files import Row, name_error
from zeroshop_steps.runtime.errors import StepError

Wildcards = Any
"""Snakemake's: the parts of a path as attributes, and by name as `**wildcards`."""


class Place(SimpleNamespace):
    """Such parts that no path has, like those of Snakemake."""

    def keys(self) -> Iterable[str]:
        """The names of the parts."""
        return vars(self).keys()

    def __getitem__(self, name: str) -> str:
        return str(vars(self)[name])


InputFunction = Callable[[Wildcards], list[str]]
Options = Mapping[str, Any]
NOTHING = "(?!)"
"""A regular expression that nothing matches."""
NAMED_FILES = {"mesh": "ply", "texture": "png", "glb": "glb", "facts": "json", "preview": "preview.png"}
"""The files of a mesh that other names of its object link to."""


def require_known(what: str, name: str, names: Iterable[str], remedy: str = "") -> str:
    """`name`; raises StepError with the known names where it is none of them."""
    names = list(names)
    if name not in names:
        raise StepError(name_error(what, name, names, remedy))
    return name


class Datasets:
    """Datasets and objects.

    Attributes:
        given: the config as Snakemake merged it, and `check_config` checked it.
        config: the same with complete sections.
        root: the folder that relative paths of the config and of the table of objects start at.
        photos: the rows of this table by (dataset, object).
        say: tells the user a line.
        object, scene, run, cell: the folders of an object's results, of a capture of it, of its registration and of a cell, with the names
            of their parts in braces, as Snakemake has wildcards.
        bop, tables, report: the folders of what belongs to a whole dataset.
        records_refusals: whether a method that cannot run here leaves a failed cell, and the rest goes on.
    """

    def __init__(self, config: Options, root: Path, photos: Mapping[tuple[str, str], Row], say: Callable[[str], None] = print) -> None:
        self.given, self.config, self.root, self.photos = config, complete_sections(config), root, photos
        self.say = functools.cache(say)
        of_dataset = f"{config['results']}/{{dataset}}"
        self.object = f"{of_dataset}/{{object}}"
        self.scene = f"{self.object}/{{scene}}"
        self.run = f"{self.scene}/{{registration}}"
        self.cell = f"{self.run}/{{nvs}}"
        self.bop, self.tables, self.report = (f"{of_dataset}/{name}" for name in ("bop", "tables", "report"))
        self.records_refusals = config["refusals"] == "record"

    def relative(self, path: str) -> Path:
        """A path of the config or the table, as seen from the working directory."""
        return Path(os.path.relpath(self.root / path))

    def quoted(self, path: str) -> str:
        """The same for a shell."""
        return shlex.quote(str(self.relative(path)))

    def options(self, options: Options) -> str:
        """Config keys as command line options: `max_features: 4000` becomes `--max-features 4000`.

        A list gives several words, null no option. The user's own `weights` lie where the config says.
        """
        if options.get("weights"):
            options = {**options, "weights": self.quoted(options["weights"])}
        words = {key: value if isinstance(value, list) else [value] for key, value in options.items() if value is not None}
        return " ".join(" ".join([f"--{key.replace('_', '-')}", *map(str, values)]) for key, values in words.items())

    def usable(self, what: str, name: str, table: dict[str, Method], remedy: str = "") -> str:
        """`name`; raises StepError where it is no method of `table`, or lacks something here, unless its step is to record that."""
        reason = methods.refusal(what, require_known(what, name, table, remedy), table)
        if reason and not self.records_refusals:
            raise StepError(reason)
        return name

    def of_kinds(self, *kinds: str) -> str:
        """A regular expression of the datasets of these kinds, for a rule's wildcard constraint."""
        return "|".join(name for name, dataset in self.config["datasets"].items() if dataset["kind"] in kinds) or NOTHING

    def dataset(self, name: str) -> Options:
        """What the config says of a dataset; raises StepError with those that exist."""
        known = self.config["datasets"]
        return known[require_known("dataset", name, known, "Datasets are listed in config/config.yaml under datasets.")]

    def is_virtual(self, dataset: str) -> bool:
        """Whether a dataset has models, so that captures are rendered and the truth is known."""
        return self.dataset(dataset)["kind"] not in ("photos", "films")

    def is_filmed(self, dataset: str) -> bool:
        """Whether a dataset's captures are rendered films: they are processed like a user's own videos, and the truth is known."""
        return self.dataset(dataset)["kind"] == "films"

    def knows_truth(self, dataset: str) -> bool:
        """Whether meshes of a dataset can be measured against a true model: those of rendered images and films."""
        return self.dataset(dataset)["kind"] != "photos"

    def virtual(self, name: str, remedy: str = "") -> str:
        """`name`; raises StepError with the datasets that have models where it is none of them."""
        return require_known("virtual dataset", name, filter(self.is_virtual, self.config["datasets"]), remedy)

    def objects(self, dataset: str) -> list[str]:
        """The objects of a dataset: from the config, or for photos from the table."""
        described = self.dataset(dataset)
        if described["kind"] == "photos":
            return [name for owner, name in self.photos if owner == dataset]
        return [name for names in described["of"].values() for name in names] if described["kind"] == "films" else described["objects"]

    def other_names(self, dataset: str) -> dict[str, str]:
        """Other names of a dataset's objects, each with the object that it stands for; a name that an object has is that object's."""
        names = self.config["datasets"].get(dataset, {}).get("names") or {}
        return {name: known for name, known in names.items() if name not in self.objects(dataset)}

    @property
    def named(self) -> str:
        """Paths of links, as a regular expression of the object in them: only here may an object be called by another name."""
        ends = "|".join(NAMED_FILES.values())
        others = {dataset: names for dataset in self.config["datasets"] if (names := self.other_names(dataset))}
        return "|".join(
            rf"(?<={self.config['results']}/{dataset}/)(?:{'|'.join(names)})(?=/[^/.]+\.(?:{ends})$)" for dataset, names in others.items()
        )

    def named_files(self, wildcards: Wildcards) -> list[str]:
        """The mesh of the object that a name stands for, and the files beside it."""
        known = self.other_names(wildcards.dataset)[wildcards.object]
        folder = self.object.format(dataset=wildcards.dataset, object=known)
        return [f"{folder}/{wildcards.nvs}.{end}" for end in NAMED_FILES.values()]

    def check_object(self, wildcards: Wildcards) -> str:
        """The object in a path.

        Raises:
            StepError: lists what exists where the path names an unknown dataset or object, or an object by another name.
        """
        names, others = self.objects(wildcards.dataset), self.other_names(wildcards.dataset)
        if wildcards.object in others:
            raise StepError(
                f"{wildcards.object} is another name of {others[wildcards.object]}; ask for this file by that one."
                f" Only a mesh is found by both, such as {self.object.format(**wildcards)}/2dgs.ply"
            )
        photos = self.config["datasets"][wildcards.dataset]["kind"] == "photos"
        where = self.config["objects_table"] if photos else "config/config.yaml"
        what = f"object of dataset {wildcards.dataset}"
        return require_known(what, wildcards.object, [*names, *others], f"Objects of this dataset are listed in {where}.")

    def models_option(self, wildcards: Wildcards) -> str:
        """The option that names a local folder of BOP models, or the checksum of the archive to download, if the config does."""
        dataset = self.config["datasets"][wildcards.dataset]
        folder = dataset["models_folder"]
        return self.options({"models": self.quoted(folder)} if folder else {"models_sha256": dataset.get("models_sha256")})

    def has_real_tests(self, dataset: str) -> bool:
        """Whether a dataset is tested on BOP's own images."""
        return bool(self.config["datasets"][dataset].get("test_folder"))

    def test_option(self, wildcards: Wildcards) -> str:
        """The option that names a local folder of test scenes; none where they are downloaded."""
        place = self.config["datasets"][wildcards.dataset]["test_folder"]
        return "" if place == "download" else f"--test {self.quoted(place)}"

    def mass_options(self, wildcards: Wildcards) -> str:
        """The options of a rigid body: the object's mass, from its row or the config, or the usual density."""
        options = self.config["assets"]
        row = self.photos.get((wildcards.dataset, wildcards.object), {})
        mass_kg = row.get("mass_kg") or options["masses_kg"].get(wildcards.dataset, {}).get(wildcards.object)
        mass = {"mass_kg": mass_kg} if mass_kg else {name: options.get(name) for name in ("density_kg_m3", "density_factor")}
        own = {"masses_kg", "package", "date", "density_kg_m3", "density_factor"}  # of other steps, or in `mass`
        others = {name: value for name, value in options.items() if name not in own}
        return self.options({"name": wildcards.object, **mass, **others, "seed": self.config["seed"]})
