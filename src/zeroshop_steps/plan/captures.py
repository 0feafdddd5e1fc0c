"""Captures: the user's own pictures, which rows of the table of objects name, rendered films and images, and the passes of an object."""

import functools
import math
import shlex
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from zeroshop_steps import methods
from zeroshop_steps.plan.datasets import Datasets, InputFunction, Place, Wildcards, require_known
from zeroshop_steps.plan.user_files import has_plain_name, list_visible, require_past
from zeroshop_steps.runtime.config_files import Row
from zeroshop_steps.runtime.errors import StepError

VIRTUAL_SCENES = ["su_l", "su_h", "se"]
BOARD_SCENE = "su_b"
"""With a printed board beside the object, by which the height is measured; in no table of meshes."""
TURNED_SCENE, JOINED_SCENE = "su_h_2", "su_f"
"""The second pass of an object, turned over on a textured ground, and both passes joined; in no table of meshes."""
WHOLE_SCENE, OBJECT_SCENE = PHOTO_SCENES = ["video", "video_segmented"]
"""Photos as they are, and registered by what lies inside the masks alone."""
LATER_PASSES = {"video_2": "_2", "video_3": "_3"}
"""The scenes of later passes, for which the object was turned over, and how their columns end."""
PASS_COLUMNS = ("images", "masks", "cameras", "depth")
"""What each pass may have of its own."""
JOINED_PHOTOS = "video_joined"
MOST_SHARE = 1.5
"""Of a row's picture_count: frames in all, with those between two that share too little."""


@functools.cache
def has_poses(cameras: str) -> bool:
    """Whether a cameras.json has poses; read once, as many rules ask."""
    from zeroshop_steps.capture.cameras_json import read_given_cameras  # loads COLMAP, which few captures need

    return read_given_cameras(Path(cameras)).has_poses


def rendered_scene(wildcards: Wildcards) -> str:
    """The scene that the renderer knows: the second pass lies on the same kind of ground as the first."""
    return "su_h" if wildcards.scene == TURNED_SCENE else wildcards.scene


def check_virtual_scene(wildcards: Wildcards) -> None:
    """Raise StepError with the scenes where a path of a virtual dataset names an unknown one."""
    require_known("scene of a virtual dataset", wildcards.scene, [*VIRTUAL_SCENES, TURNED_SCENE, JOINED_SCENE])


class Captures(Datasets):
    """What a capture is made of."""

    def row_name(self, wildcards: Wildcards) -> str:
        """A row of the table of objects, as errors begin."""
        return f"{self.config['objects_table']}: {wildcards.dataset} {wildcards.object}"

    def row(self, wildcards: Wildcards) -> Row:
        """The table row of the user's own capture, or one made up for rendered films; in the scene of a later pass with what that has."""
        self.check_object(wildcards)
        filmed = self.is_filmed(wildcards.dataset)
        row = self._film_row(wildcards) if filmed else self.photos[wildcards.dataset, wildcards.object]
        end = self.pass_end(wildcards)
        return {**row, **{column: row.get(column + end, "") for column in PASS_COLUMNS}} if end else row

    def pass_end(self, wildcards: Wildcards) -> str:
        """How the columns of the pass end whose scene the path names."""
        return LATER_PASSES.get(getattr(wildcards, "scene", ""), "")

    def _film_row(self, wildcards: Wildcards) -> Row:
        folder = f"{self.object.format(**wildcards)}/film"
        described = self.dataset(wildcards.dataset)
        scene = "" if described["board"] == "beside" else f"{folder}/empty_scene"
        row: Row = dict.fromkeys(("masks", "prompt", "depth", "cameras", "scene_of", "images_2", "images_3"), "")
        row |= {"height_m": None, "picture_count": None, "images": f"{folder}/film.mp4", "height_method": "marker", "marker_images": scene}
        if scene and described.get("table", "print") != "print":
            row |= {"height_method": "", "marker_images": ""}  # nothing tells where photos of an empty plain table lie: unknown scale
        if described.get("passes", 1) > 1:
            row["images_2"] = f"{folder}_2/film.mp4"
        return row

    def later_passes(self, wildcards: Wildcards) -> list[str]:
        """The scenes of an object's later passes, in their order; none where it has one pass.

        Raises:
            StepError: a pass has something, but no pictures.
        """
        row = self.row(wildcards)
        for end in LATER_PASSES.values():
            alone = [column + end for column in PASS_COLUMNS if row.get(column + end) and not row[f"images{end}"]]
            if alone:
                raise StepError(f"{self.row_name(wildcards)}: {alone[0]} belongs to the pictures in images{end}, which is empty; name them")
        return [scene for scene, end in LATER_PASSES.items() if row[f"images{end}"]]

    def place_in(self, scene: str, wildcards: Wildcards) -> Place:
        """The same place in another scene of the object."""
        return Place(**{**wildcards, "scene": scene})

    def scene_owner(self, wildcards: Wildcards) -> str:
        """The object whose photos show this one, too; empty where it has photos of its own."""
        return self.row(wildcards)["scene_of"]

    def of_owner(self, path: str) -> InputFunction:
        """An input function: this path of the object whose photos show the one of the wildcards; nothing where it has photos of its own."""

        def owned(wildcards: Wildcards) -> list[str]:
            owner = self.scene_owner(wildcards)
            return [path.format(**{**wildcards, "object": owner})] if owner else []

        return owned

    @property
    def shared(self) -> list[str]:
        """Objects in photos of other ones."""
        return [name for (_, name), row in self.photos.items() if row["scene_of"]]

    def find(self, wildcards: Wildcards, column: str) -> str:
        """The folder or video in a column of the table, as seen from the working directory.

        Raises:
            StepError: it does not exist, or Snakemake cannot name it.
        """
        row = self.row(wildcards)
        if self.is_filmed(wildcards.dataset):
            return row[column]
        path, name = self.relative(row[column]), column + (self.pass_end(wildcards) if column in PASS_COLUMNS else "")
        if not has_plain_name(path):
            shown = row[column].encode(errors="backslashreplace").decode()
            raise StepError(
                f"{self.row_name(wildcards)}: the path of its {name}, {shown}, holds braces or is not UTF-8; rename the"
                " folder or the video with plain letters and digits"
            )
        pictures = column == "images"
        if row[column] and (path.is_dir() or (path.is_file() and (pictures or column == "cameras"))):
            return str(path)
        raise StepError(
            f"{self.row_name(wildcards)}: the {'video or ' if pictures else ''}folder of its {name}, {row[column]}, does not exist."
            " Relative paths start at the folder of the workflow; correct the path."
        )

    def images(self, wildcards: Wildcards) -> str:
        """The folder or video of a pass."""
        return self.find(wildcards, "images")

    def list_filmed(self, names: Iterable[str]) -> list[str]:
        """Those of these objects of `photos` whose pictures are there, and those of the empty scene, if their row names some."""
        places = {name: [self.photos["photos", name][column] for column in ("images", "marker_images")] for name in names}
        return [name for name, found in places.items() if found[0] and all((self.root / place).exists() for place in found if place)]

    def files(self, column: str) -> InputFunction:
        """An input function: the files that a column of the table names, if it does, so that a changed photo reruns what depends on it."""

        def found(wildcards: Wildcards) -> list[str]:
            if not self.row(wildcards)[column] and column != "images":
                return []
            place = Path(self.find(wildcards, column))
            if self.is_filmed(wildcards.dataset):
                return [str(place)]
            files = [place] if place.is_file() else list(filter(has_plain_name, list_visible(place)))
            require_past(files, f"{place}/*" if place.is_dir() else str(place))
            return sorted(map(str, files))

        return found

    def image_files(self, wildcards: Wildcards) -> list[str]:
        """The files of a pass."""
        return self.files("images")(wildcards)

    def odd_names(self, wildcards: Wildcards) -> list[str]:
        """Photos whose names Snakemake cannot take as inputs, with size and time: a parameter, so that changes are noticed."""
        place = Path(self.images(wildcards))
        odd = [] if place.is_file() or self.is_filmed(wildcards.dataset) else [p for p in list_visible(place) if not has_plain_name(p)]
        return [f"{ascii(path.name)} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in sorted(odd)]

    def capture_method(self, wildcards: Wildcards) -> str:
        """How the pictures of a pass are taken: from a video or from a folder of photos."""
        return "photos" if Path(self.images(wildcards)).is_dir() else "video"

    def capture_options(self, wildcards: Wildcards) -> str:
        """The options of this method: how many frames of a video, or how many photos, and their masks and cameras, if there are any."""
        row, config = self.row(wildcards), self.config
        count, given = row["picture_count"], [name for name in ("masks", "cameras") if row[name]]
        if self.capture_method(wildcards) == "photos":
            own: dict[str, Any] = {name: shlex.quote(self.find(wildcards, name)) for name in given}
            return self.options({**own, **config["photos"], **({"most_images": count} if count else {})})
        if given:
            raise StepError(f"{self.row_name(wildcards)}: a video has no {given[0]}; leave the {given[0]} empty, they are found")
        own = {"frames": count, "most_frames": max(config["video"]["most_frames"], math.ceil(MOST_SHARE * count))} if count else {}
        return self.options({**config["video"], **own})

    def filmed_object(self, wildcards: Wildcards) -> str:
        """The folder of the object that is filmed, in its own dataset."""
        name, of = self.check_object(wildcards), self.dataset(wildcards.dataset)["of"]
        [dataset] = [dataset for dataset, names in of.items() if name in names]
        return self.object.format(dataset=self.virtual(dataset, "Films are of models."), object=name)

    def filmed(self, model: str) -> Callable[[Wildcards], str]:
        """An input function: this folder of the object that is filmed, in its own dataset: its model, as it is or turned over."""
        return lambda wildcards: f"{self.filmed_object(wildcards)}/{model}"

    def registered_scene(self, wildcards: Wildcards) -> str:
        """The scene as a registration knows it: a later pass lies on a ground as the first one does."""
        return WHOLE_SCENE if wildcards.scene in LATER_PASSES else rendered_scene(wildcards)

    def film_options(self, wildcards: Wildcards) -> str:
        """Where the printed board of a dataset's films lies, and what the table's top looks like."""
        described = self.dataset(wildcards.dataset)
        return self.options({"board": described["board"], "table": described.get("table", "print")})

    def film_truth(self, wildcards: Wildcards) -> list[str]:
        """The truth of a rendered film; a virtual capture, and that of joined films, have their own."""
        if not self.is_filmed(wildcards.dataset) or wildcards.scene == JOINED_PHOTOS:
            return []
        return [f"{self.object}/{'film_2' if wildcards.scene in LATER_PASSES else 'film'}/truth".format(**wildcards)]

    def true_model(self, wildcards: Wildcards) -> str:
        """The model that was rendered or filmed."""
        return f"{self.filmed_object(wildcards) if self.is_filmed(wildcards.dataset) else self.object.format(**wildcards)}/model"

    def passes(self, wildcards: Wildcards) -> list[str]:
        """The scenes of an object's passes, the first first."""
        self.check_object(wildcards)
        if self.is_virtual(wildcards.dataset):
            return ["su_h", TURNED_SCENE]
        scenes = self.later_passes(wildcards)
        if not scenes:
            raise StepError(f"{self.row_name(wildcards)} has one pass only; name pictures of the object turned over in the column images_2")
        return [WHOLE_SCENE, *scenes]

    def of_passes(self, path: str) -> InputFunction:
        """An input function: this file or folder of every pass; `path` begins with its scene."""
        return lambda wildcards: [f"{self.object}/{scene}/{path}".format(**wildcards) for scene in self.passes(wildcards)]

    def turned_models(self, wildcards: Wildcards) -> list[str]:
        """The model as it was turned for the second pass, where it is known."""
        if self.is_filmed(wildcards.dataset):
            return [f"{self.filmed_object(wildcards)}/turned_model"]
        return [f"{self.object}/turned_model".format(**wildcards)] if self.is_virtual(wildcards.dataset) else []

    def film_truths(self, wildcards: Wildcards) -> list[str]:
        """The truth of both films of an object that was filmed twice."""
        names = ("film", "film_2") if self.is_filmed(wildcards.dataset) else ()
        return [f"{self.object}/{name}/truth".format(**wildcards) for name in names]

    def brings_poses(self, wildcards: Wildcards) -> bool:
        """Whether a capture brings the poses of its cameras, rather than lenses alone. Raises StepError where their file is wrong."""
        return bool(self.row(wildcards)["cameras"]) and has_poses(self.find(wildcards, "cameras"))

    def chosen_run(self, wildcards: Wildcards) -> dict[str, str]:
        """The scene and registration that the config chooses for an object; of one with several passes, the joined scene.

        A capture that brings poses is registered by these.
        """
        if self.is_virtual(wildcards.dataset):
            return self.config["chosen"]["virtual"]
        chosen, later = self.config["chosen"]["photos"], self.later_passes(wildcards)
        brings = [self.brings_poses(self.place_in(scene, wildcards)) for scene in (WHOLE_SCENE, *later)]
        if any(brings):
            if not all(brings):
                raise StepError(f"{self.row_name(wildcards)}: not every pass brings the poses of its cameras; give those of all, or none")
            chosen = {"scene": WHOLE_SCENE, "registration": str(methods.BY_GIVEN_CAMERAS)}
        joined = chosen["scene"] == WHOLE_SCENE and later
        return {**chosen, "scene": JOINED_PHOTOS} if joined else chosen

    def rendered_model(self, wildcards: Wildcards) -> str:
        """The model that is rendered in a scene, as it stands there."""
        check_virtual_scene(wildcards)
        return f"{self.object}/{'turned_model' if wildcards.scene == TURNED_SCENE else 'model'}".format(**wildcards)

    def rendered_seed(self, wildcards: Wildcards) -> int:
        """The seed of its ground and noise: in the second pass, the object lies on another print."""
        return self.config["seed"] + (wildcards.scene == TURNED_SCENE)

    def renderer_options(self, wildcards: Wildcards) -> str:
        """The options of captures beside their size: the cameras and lights, and what not every renderer has."""
        capture = self.config["capture"]
        others = {key: value for key, value in capture.items() if key not in ("renderer", "samples", "image_width_px", "image_height_px")}
        samples = capture["samples"] if methods.RENDERERS[capture["renderer"]].samples else None
        return self.options({**others, "samples": samples})
