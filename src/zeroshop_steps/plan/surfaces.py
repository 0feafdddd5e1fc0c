"""The surface methods, detectors and pose estimators that paths choose, with their options and inputs."""

import dataclasses
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

from zeroshop_steps import methods
from zeroshop_steps.methods import Method
from zeroshop_steps.plan.captures import JOINED_PHOTOS, LATER_PASSES, OBJECT_SCENE
from zeroshop_steps.plan.choices import Choices
from zeroshop_steps.plan.datasets import InputFunction, Options, Place, Wildcards, require_known

NAMED_AFTER = "The folder is named after the method."


class Surfaces(Choices):
    """Methods of meshes, and of what is done with them.

    Attributes:
        surfaces, detectors, estimators: by name, with the networks that the config names.
        proposing: each detector with each of the networks that can propose regions to it, whatever the config says: the two by
            DETECTOR_NETWORK, such as cnos_sam.
        all_detectors: the detectors, these included.
    """

    def __init__(self, config: Options, root: Path, *rest: Any) -> None:
        super().__init__(config, root, *rest)
        surfaces, self.detectors, self.estimators = (self.methods_of(section) for section in ("nvs", "detect", "pose"))
        self.surfaces = {name: self._read_sparse_points(method) for name, method in surfaces.items()}
        detectors = methods.DETECTORS.items()
        self.proposing = {f"{name}_{network}": (name, network) for name, own in detectors for network in own.choices.get("proposals", {})}
        named = {name: methods.DETECTORS[own].with_options(self.detector_section(name)) for name, (own, _) in self.proposing.items()}
        self.all_detectors = self.detectors | named

    def _read_sparse_points(self, method: Method) -> Method:
        """A surface method as the config has it: one that starts from sparse points reads no stereo."""
        sparse = method.options and self.surface_section(method, 0).get("initialization") == "sparse"
        return dataclasses.replace(method, stereo=False) if sparse else method

    def surface_section(self, method: Method, step: int) -> dict[str, Any]:
        """The options that the config has for a step of a surface method."""
        options = self.section("nvs", method.name)
        return options.get(method.options[step], {}) if method.options else options

    def depth_places(self, wildcards: Wildcards) -> dict[str, Place]:
        """The passes with depth images that measure the surface of a capture, by the option of stereo that names their folder.

        They are aligned with the photos as these were taken, not with photos that were undistorted to find the masks.
        """
        undistorted = wildcards.scene == OBJECT_SCENE and self.masks(wildcards).in_scene
        if self.is_virtual(wildcards.dataset) or undistorted:
            return {}
        scenes = self.passes(wildcards) if wildcards.scene == JOINED_PHOTOS else [wildcards.scene]
        options = ("depth", *(f"depth{end}" for end in LATER_PASSES.values()))
        places = dict(zip(options, (self.place_in(scene, wildcards) for scene in scenes), strict=False))
        return {option: place for option, place in places.items() if self.row(place)["depth"]}

    def depth_files(self, wildcards: Wildcards) -> list[str]:
        """The depth images of these passes."""
        return [file for place in self.depth_places(wildcards).values() for file in self.files("depth")(place)]

    def depth_capture(self, wildcards: Wildcards) -> list[str]:
        """The capture, which says what its photos were called, where it has depth images."""
        return [f"{self.scene}/capture".format(**wildcards)] if self.depth_files(wildcards) else []

    def stereo_options(self, wildcards: Wildcards) -> str:
        """The options of stereo; with depth images, their folder, unit and kind of camera."""
        options = {**self.config["stereo"], "seed": self.config["seed"]}
        camera, step_mm = options.pop("depth_camera"), self.config["height"]["depth_camera"]["step_mm"]
        for capture in self.depth_capture(wildcards):
            folders = {option: shlex.quote(self.find(place, "depth")) for option, place in self.depth_places(wildcards).items()}
            options |= {"depth_camera": camera, "depth_step_mm": step_mm, **folders, "capture": capture}
        return self.options(options)

    def training_options(self, method: Method) -> Callable[[Wildcards], str]:
        """A parameter function: the options of its first step; of a capture without a ground, with the iterations that those have."""
        section = self.surface_section(method, 0)
        usual = {key: value for key, value in section.items() if key != "object_iterations"}
        alone = {"iterations": section["object_iterations"]} if section.get("object_iterations") else {}
        return lambda wildcards: self.options(usual | alone if wildcards.scene in ("se", OBJECT_SCENE) else usual)

    def surface_inputs(self, method: Method) -> dict[str, str]:
        """What a surface method reads: cameras, or the capture alone, and confirmed depths."""
        cameras = {"cameras": f"{self.run}/cameras"} if method.registration else {"capture": f"{self.scene}/capture"}
        return cameras | ({"stereo": f"{self.run}/stereo/seeds.npz"} if method.stereo else {})

    def confirmed_depths(self, wildcards: Wildcards) -> list[str]:
        """The depths that stereo confirmed, if the surface method of the path reads them; then later steps read them, too."""
        method = self.surfaces.get(wildcards.nvs)
        return [f"{self.run}/stereo/seeds.npz".format(**wildcards)] if method is None or method.stereo else []

    def height_option(self, wildcards: Wildcards) -> str:
        """The height that the user gives, for a method that has no cameras to measure it."""
        given = wildcards.registration == methods.WITHOUT_CAMERAS and not self.is_virtual(wildcards.dataset)
        return self.options({"height_m": self.row(wildcards)["height_m"]} if given else {})

    def raw_mesh(self, wildcards: Wildcards) -> str:
        """The mesh that the surface method of the path makes."""
        self.usable("nvs method", wildcards.nvs, self.surfaces, NAMED_AFTER)
        return f"{self.cell}/raw_mesh.ply".format(**wildcards)

    def proposed_mesh(self, wildcards: Wildcards) -> list[str]:
        """The generated mesh that proposes what of a measured one no photo saw, where the config wants that."""
        method = self.surfaces.get(wildcards.nvs)
        if self.config["finish"]["unseen"] == "smooth" or method is None or method.generated:
            return []
        name = next(name for name, other in self.surfaces.items() if other.generated)
        self.usable("nvs method", name, self.surfaces, "finish.unseen: generated needs it.")
        return [f"{self.run}/{name}/raw_mesh.ply".format(**wildcards)]

    def generated_mesh(self, wildcards: Wildcards) -> list[str]:
        """The generated mesh whose colours the texture takes where no photo looks: the cell's own, or one that completes its mesh."""
        method = self.surfaces.get(wildcards.nvs)
        return [f"{self.cell}/raw_mesh.ply".format(**wildcards)] if method and method.generated else self.proposed_mesh(wildcards)

    def generated_without_cameras(self, wildcards: Wildcards) -> list[str]:
        """The mesh that a generative method makes of a capture alone, with its figures; other cells without cameras end before."""
        self.check_object(wildcards)
        self.usable("nvs method", wildcards.nvs, self.surfaces, NAMED_AFTER)
        if not self.surfaces[wildcards.nvs].generated:
            self.refuse_without_cameras(wildcards)
        return [f"{self.cell}/raw_mesh.{end}".format(**wildcards) for end in ("ply", "json")]

    def stage_facts(self, wildcards: Wildcards) -> list[str]:
        """The records of the stages behind a mesh, for its JSON."""
        method = self.surfaces[require_known("nvs method", wildcards.nvs, methods.SURFACES, NAMED_AFTER)]
        stereo = [f"{self.run}/stereo/stereo.json"] if method.stereo else []
        training = [f"{self.cell}/{Path(method.model).parent}/training.json"] if method.model else []
        steps = (f"{self.cell}/{name}.json" for name in ("raw_mesh", "clean", "height", "closed"))
        return [path.format(**wildcards) for path in (*stereo, *training, *steps)]

    # Detectors and estimators

    def detector_section(self, name: str) -> dict[str, Any]:
        """The options that the config gives a detector, or one of `proposing`."""
        detector, network = self.proposing.get(name, (name, None))
        return self.section("detect", detector) | ({"proposals": network} if network else {})

    def detector_weights(self, name: str) -> InputFunction:
        """An input function: the weights of a detector; where refusals are recorded, those that are there.

        It raises StepError with how to get them where they are not there.
        """
        files = [methods.WEIGHTS_FOLDER / file for file in self.all_detectors[name].files]

        def weights(wildcards: Wildcards) -> list[str]:
            self.usable("detector", name, self.all_detectors, "The folder is named after the detector.")
            return [str(file) for file in files if file.is_file() or not self.records_refusals]

        return weights

    def estimator(self, wildcards: Wildcards) -> Method:
        """The estimator of the path."""
        return self.estimators[wildcards.estimator]

    def detections(self, wildcards: Wildcards) -> list[str]:
        """The detections that poses are estimated from; none where the masks are the true ones."""
        self.usable("pose estimator", wildcards.estimator, self.estimators, "The folder is named ESTIMATOR-MASKS-MODELS.")
        if wildcards.masks == "truth":
            return []
        self.usable("detector", wildcards.masks, self.all_detectors, "The folder is named ESTIMATOR-MASKS-MODELS.")
        return [f"{self.bop}/{{masks}}-{{models}}/{self.all_detectors[wildcards.masks].masks}".format(**wildcards)]

    def templates(self, wildcards: Wildcards) -> list[str]:
        """The views of the models, for an estimator that reads them."""
        return [f"{self.bop}/templates/{{models}}/42".format(**wildcards)] if self.estimator(wildcards).templates else []
