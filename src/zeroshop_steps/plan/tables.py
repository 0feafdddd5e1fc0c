"""What the tables of a dataset are made of."""

import json
import shlex
from collections.abc import Callable

from zeroshop_steps import methods
from zeroshop_steps.plan.captures import BOARD_SCENE, WHOLE_SCENE
from zeroshop_steps.plan.cells import Cells
from zeroshop_steps.plan.datasets import InputFunction, Wildcards
from zeroshop_steps.runtime.errors import StepError

SCALE_ERRORS_PERCENT = (-10, -5, -2, 2, 5, 10)
DAMAGES = {
    **{f"scaled_{'minus' if error < 0 else 'plus'}_{abs(error)}": f"--scale-percent {error}" for error in SCALE_ERRORS_PERCENT},
    "without_underside": "--open-underside",
}
"""How true models are damaged on purpose, to see what poses and grasps lose, and the option for it."""
NO_TEST_SET, NO_MODELS = "Photos have no test set.", "Photos have no true models."


class Tables(Cells):
    """Inputs and settings of tables."""

    @property
    def root_option(self) -> str:
        """The option that tells a step that reads the coordinates of a cell from its path where these begin; it knows the usual folder."""
        return "" if self.config["results"] == "results" else f"--root {self.config['results']}"

    def camera_errors(self, wildcards: Wildcards) -> list[str]:
        """How right the cameras of each registration in the tables are."""
        cells = [cell for cell in self.cells_of_table(wildcards) if cell["registration"] != methods.WITHOUT_CAMERAS]
        return list(dict.fromkeys(f"{self.run}/camera_error.csv".format(**cell) for cell in cells))

    def measured_heights(self, wildcards: Wildcards) -> list[str]:
        """The height of every object of a dataset by the board, beside it and in the empty scene, and by MASt3R if it can run here.

        Of the user's own photos, those objects whose height is known and that have photos of the empty scene, by MASt3R alone. Failures
        are rows of the table.
        """
        nvs, chosen = self.surfaces_with_cameras("the table of heights")[0], self.config["chosen"]
        cell = {"dataset": wildcards.dataset, "nvs": nvs}
        if self.dataset(wildcards.dataset)["kind"] == "photos":
            rows = {name: row for (owner, name), row in self.photos.items() if owner == wildcards.dataset}
            known = [name for name, row in rows.items() if row["height_m"] and row["marker_images"]]
            known = self.list_filmed(known) if self.records_refusals else known
            if not known:
                table = self.config["objects_table"]
                raise StepError(f"{table}: no object of {wildcards.dataset} has both height_m and marker_images to compare")
            cell |= {"scene": WHOLE_SCENE, "registration": chosen["photos"]["registration"]}
            return [f"{self.cell}/height_by_mast3r.json".format(**cell, object=name) for name in known]
        self.virtual(wildcards.dataset)
        means = [("height_by_board", BOARD_SCENE), ("height_by_board", "su_h")]
        means += [] if methods.lacks(self.heights["mast3r"]) else [("height_by_mast3r", "su_h")]
        places = [f"{self.object}/{scene}/{chosen['virtual']['registration']}/{{nvs}}/{file}.json" for file, scene in means]
        return [place.format(**cell, object=name) for name in self.objects(wildcards.dataset) for place in places]

    def of_films(self, path: str) -> InputFunction:
        """An input function: this file of every film of a dataset, a failure where it could not be made."""

        def files(wildcards: Wildcards) -> list[str]:
            registration, nvs = self.config["chosen"]["photos"]["registration"], self.surfaces_with_cameras("the table of films")[0]
            run = {"dataset": wildcards.dataset, "scene": WHOLE_SCENE, "registration": registration, "nvs": nvs}
            return [path.format(**run, object=name) for name in self.objects(wildcards.dataset)]

        return files

    def scores(self, wildcards: Wildcards) -> list[str]:
        """The scores of every detector and estimator that the config wants in tables, with true and with reconstructed models."""
        self.virtual(wildcards.dataset, NO_TEST_SET)
        self.say_what_is_left_out("nvs", "detectors", "estimators")
        detectors, poses = self.axis("detectors"), self.config["tables"]["poses"]
        if poses == "all":
            poses = [f"{estimator}-{masks}" for estimator in self.axis("estimators") for masks in ("truth", *detectors)]
        runs = [*(f"{detector}-MODELS/precision" for detector in detectors), *(f"{pair}-MODELS/scores" for pair in poses)]
        folders = ["models", *(f"models_{nvs}" for nvs in self.surfaces_with_cameras("the table of the benchmark"))]
        bop = self.bop.format(**wildcards)
        return [f"{bop}/{run.replace('MODELS', models)}.csv" for models in folders for run in runs]

    def compared_scores(self, kind: str, *runs: str) -> InputFunction:
        """An input function: scores of these runs with true models, with the same without underside, and with reconstructed ones."""

        def scores(wildcards: Wildcards) -> list[str]:
            self.virtual(wildcards.dataset, NO_TEST_SET)
            reconstructed = [f"models_{nvs}" for nvs in self.measured_surfaces(f"the table of {kind}")]
            folders = ["models", "models_without_underside", *reconstructed]
            return [f"{self.bop}/{run}-{models}/{kind}.csv".format(**wildcards) for models in folders for run in runs]

        return scores

    def robustness_scores(self, wildcards: Wildcards) -> list[str]:
        """The scores of poses from true masks with the true models and with damaged ones."""
        self.virtual(wildcards.dataset, NO_TEST_SET)
        run = f"{self.bop}/{self.axis('estimators')[0]}-truth".format(**wildcards)
        return [f"{run}-{models}/scores.csv" for models in ("models", *(f"models_{damage}" for damage in DAMAGES))]

    def score_settings(self, wildcards: Wildcards) -> str:
        """What tells a table of scores from others: the test images, the cells of its models, and the options of its networks; as JSON."""
        test_folder = self.dataset(wildcards.dataset).get("test_folder")
        networks = {stage: self.config[stage] for stage in ("detect", "pose")}
        return json.dumps({"test_folder": test_folder, **self.config["chosen"]["virtual"], **networks})

    def published_option(self, wildcards: Wildcards) -> str:
        """The option that puts published figures beside ours, for the dataset that has some."""
        return "--published" if wildcards.dataset == "ycbv" else ""

    def score_options(self, published: bool = False) -> Callable[[Wildcards], str]:
        """A parameter function: the options of a table of scores, whether the dataset is tested on real images among them."""

        def options(wildcards: Wildcards) -> str:
            images = "--real-images" if self.has_real_tests(wildcards.dataset) else ""
            settings = f"--settings {shlex.quote(self.score_settings(wildcards))}"
            return " ".join([*([self.published_option(wildcards)] if published else []), images, settings, self.root_option])

        return options

    # Grasps

    def published_errors(self, dataset: str) -> dict[str, float]:
        """Errors in per cent of the heights that the thesis estimated for a dataset's objects, by object: there are some of YCB-V."""
        if dataset != "ycbv":
            return {}
        from zeroshop_steps.report.heights import read_published_heights  # loads Matplotlib, which few targets need

        known = {found.ycbv_object: found.difference_percent for found in read_published_heights()}
        return {name: known[name] for name in self.objects(dataset) if name in known}

    def height_errors(self, wildcards: Wildcards) -> str:
        """The option that gives the model of each of these objects such an error; those of the others stay as they are."""
        errors = self.published_errors(wildcards.dataset)
        return "--scale-percent-of " + " ".join(f"{int(name.removeprefix('obj_'))}={percent}" for name, percent in errors.items())

    def robots(self, dataset: str) -> list[str]:
        """The folders of models that robots know in the table: the true ones, and those of every surface method that measures.

        The latter also with the errors of the heights that the thesis published, where it published some of these objects.
        """
        self.virtual(dataset, NO_MODELS)
        kinds = ["delivered", "misjudged"] if self.published_errors(dataset) else ["delivered"]
        return ["models", *(f"models_{kind}_{nvs}" for kind in kinds for nvs in self.measured_surfaces("the table of grasps"))]

    def attempts(self, wildcards: Wildcards) -> list[str]:
        """The attempts with every object of a dataset, by every robot; by those with wrong heights, with the objects that these are of."""
        bop, names = self.bop.format(**wildcards), self.objects(wildcards.dataset)
        wrong = self.published_errors(wildcards.dataset)
        robots = {models: wrong if "_misjudged_" in models else names for models in self.robots(wildcards.dataset)}
        return [f"{bop}/grasping/{models}/{name}" for models, own in robots.items() for name in own]

    def sightings(self, wildcards: Wildcards) -> list[str]:
        """What every robot makes of several things on a table."""
        return [f"{self.bop}/sightings/{models}".format(**wildcards) for models in self.robots(wildcards.dataset)]

    def damaged_attempts(self, wildcards: Wildcards) -> list[str]:
        """The attempts with every object of a dataset, by robots that know true models or damaged ones."""
        self.virtual(wildcards.dataset, NO_MODELS)
        bop, robots = self.bop.format(**wildcards), ["models", *(f"models_{damage}" for damage in DAMAGES)]
        return [f"{bop}/grasping/{models}/{name}" for models in robots for name in self.objects(wildcards.dataset)]
