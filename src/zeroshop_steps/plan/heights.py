"""How the height of an object is measured, and by what."""

import shlex

from zeroshop_steps import methods
from zeroshop_steps.methods import Method
from zeroshop_steps.plan.captures import BOARD_SCENE, OBJECT_SCENE, WHOLE_SCENE
from zeroshop_steps.plan.datasets import InputFunction, Wildcards
from zeroshop_steps.plan.surfaces import Surfaces
from zeroshop_steps.runtime.errors import StepError

KNOWN_HEIGHT, UNKNOWN_HEIGHT = "known", "none"
"""The methods where a row names none: with a height, and without one."""


class Heights(Surfaces):
    """Methods of the height."""

    def height_method(self, wildcards: Wildcards) -> str:
        """How the height of an object is measured; rendered heights are known."""
        if self.is_virtual(wildcards.dataset):
            return KNOWN_HEIGHT
        row = self.row(wildcards)
        without = str(methods.HEIGHT_BY_GIVEN_CAMERAS) if self.brings_poses(wildcards) else UNKNOWN_HEIGHT
        return self.usable("height method", row["height_method"] or (without if row["height_m"] is None else KNOWN_HEIGHT), self.heights)

    def height(self, wildcards: Wildcards) -> Method:
        """What this method needs."""
        return self.heights[self.height_method(wildcards)]

    def height_weights(self, wildcards: Wildcards) -> list[str]:
        """The files that it reads its networks from."""
        return self.weights_stamp("height", self.height(wildcards))

    def height_photos(self, column: str) -> InputFunction:
        """An input function: the files in a folder of the table that only some height methods read; none where they do not."""
        return lambda wildcards: self.files(column)(wildcards) if column in self.height(wildcards).columns else []

    def height_options(self, wildcards: Wildcards) -> str:
        """The options of the height method."""
        method = self.height(wildcards)
        options = self.section("height", method.name) | ({"seed": self.config["seed"]} if method.seed else {})
        if self.is_virtual(wildcards.dataset):
            return self.options(options)
        row, name = self.row(wildcards), self.row_name(wildcards)
        for column in method.required:
            if not row[column]:
                raise StepError(f"{name}: height_method {method.name} needs the folder of {column} images in the column {column}")
        if method.original_photos and self.capture_method(wildcards) == "video":
            raise StepError(f"{name}: {method.name} images belong to photos, images names a video; export the colour images as photos, too")
        if method.original_photos and wildcards.scene == OBJECT_SCENE and self.masks(wildcards).in_scene:
            raise StepError(
                f"{wildcards.dataset} {wildcards.object}: scene {OBJECT_SCENE} is made of photos that were undistorted to find the masks"
                f", with which depth images are not aligned; take scene {WHOLE_SCENE}, give masks, or another segmentation"
            )
        places = {column: shlex.quote(self.find(wildcards, column)) for column in method.columns if self.height_photos(column)(wildcards)}
        return self.options({**options, "height_m": row["height_m"], **places})

    def empty_scene(self, wildcards: Wildcards) -> list[str]:
        """The photos of the empty scene with the board, for rendered views without it."""
        return [] if wildcards.scene == BOARD_SCENE else [f"{self.scene}/empty_scene".format(**wildcards)]

    def empty_scene_options(self, wildcards: Wildcards) -> str:
        """The option that names them, and those of the printed board."""
        photos = [f"{path}/images" for path in self.empty_scene(wildcards)]
        return self.options({"marker_images": photos or None, **self.config["height"]["marker"], "seed": self.config["seed"]})

    def mast3r_photos(self, wildcards: Wildcards) -> list[str]:
        """The photos of the empty scene, rendered, or of the user's row."""
        self.usable("height method", "mast3r", self.heights, "The file is named after the method.")
        return self.empty_scene(wildcards) if self.is_virtual(wildcards.dataset) else self.files("marker_images")(wildcards)

    def mast3r_options(self, wildcards: Wildcards) -> str:
        """The options of MASt3R: its own, where the photos lie, and the height that it is compared with."""
        options = dict(self.config["height"]["mast3r"])
        if self.is_virtual(wildcards.dataset):
            return self.options({**options, "marker_images": f"{self.scene}/empty_scene/images".format(**wildcards)})
        photos = shlex.quote(self.find(wildcards, "marker_images"))
        return self.options({**options, "marker_images": photos, "height_m": self.row(wildcards)["height_m"]})
