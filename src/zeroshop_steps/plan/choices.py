"""The registrations and the masks that paths, rows and the config choose, with their options, weights and networks."""

import functools
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from zeroshop_steps import methods
from zeroshop_steps.methods import Method
from zeroshop_steps.networks.mobile_sam.choice import DEFAULT, NONE, segmenter_path
from zeroshop_steps.networks.saliency import salient_networks
from zeroshop_steps.plan.captures import (
    BOARD_SCENE,
    JOINED_PHOTOS,
    JOINED_SCENE,
    LATER_PASSES,
    OBJECT_SCENE,
    PHOTO_SCENES,
    TURNED_SCENE,
    VIRTUAL_SCENES,
    WHOLE_SCENE,
    Captures,
)
from zeroshop_steps.plan.datasets import Options, Wildcards, require_known
from zeroshop_steps.runtime.errors import StepError

[GIVEN_MASKS] = [name for name, method in methods.find_methods("segment").items() if method.given]


class Choices(Captures):
    """Methods of photos, and the networks that methods need.

    Attributes:
        segmentations, heights: by name, with the networks that the config names.
    """

    def __init__(self, config: Options, root: Path, *rest: Any) -> None:
        super().__init__(config, root, *rest)
        self.segmentations, self.heights = (self.methods_of(section) for section in ("segment", "height"))
        self.salient_network = functools.cache(self._find_salient_network)

    def section(self, stage: str, name: str) -> dict[str, Any]:
        """The options that the config has for a method of a stage."""
        return self.config[stage].get(name) or {}

    def methods_of(self, stage: str) -> dict[str, Method]:
        """The methods of a stage by name, with the networks that the config names."""
        return {name: self.with_own_weights(stage, method) for name, method in methods.SECTIONS[stage].items()}

    def with_own_weights(self, stage: str, method: Method) -> Method:
        """A method with the networks that the config names. With the user's own, it needs no published weights."""
        return method.with_options(self.section(stage, method.name))

    def gpu_mem_mb(self, stage: str, method: Method) -> int:
        """GPU memory in MB that a step may take; 0 where the config has it run on the processor."""
        return method.gpu_mem_mb(self.section(stage, method.name))

    def weights_stamp(self, stage: str, method: Method, networks: Sequence[Path] = ()) -> list[str]:
        """Size and time of the files that a method reads its networks from: a parameter, so that other weights make its results stale.

        Not an input: Snakemake would delete and download weights again whenever their rule changes.

        Args:
            stage: the part of the config with its options.
            method: the method.
            networks: files of other networks that it uses.
        """
        needed = [file for one in (method, *map(methods.REGISTRATIONS.__getitem__, method.tries)) for file in one.files]
        files = [methods.WEIGHTS_FOLDER / file for file in needed]
        if own := self.section(stage, method.name).get("weights"):
            path = self.relative(own)
            files = sorted(path.iterdir()) if path.is_dir() else [path]
        files += networks
        return [f"{path} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in files if path.is_file()]

    def _find_salient_network(self, needed: bool = False) -> Path | None:
        """The file of the salient-object network of the config, as steps are given it; None where there is none.

        The default network may be missing or damaged where it is not needed: a warning says so, and the rest goes on without it.
        """
        network = self.config["segment"]["saliency"]["network"]
        known = network in (*salient_networks.NETWORKS, salient_networks.NONE)
        return salient_networks.find_network(network if known else str(self.relative(network)), needed)

    def network_options(self, network: Path | None) -> Options:
        """Options of a step that name this salient-object network; none where there is none."""
        described = self.config["segment"]["saliency"]
        named = {"network": shlex.quote(str(network)), "mean": described["mean"], "deviation": described["deviation"]}
        return named if network else {}

    # Registrations

    def registrations(self, dataset: str) -> dict[str, Method]:
        """The registrations that make sense for a dataset: photos have no true cameras, and nothing rendered brings any of its own."""
        virtual = self.is_virtual(dataset)
        return {
            name: self.with_own_weights("register", method)
            for name, method in methods.REGISTRATIONS.items()
            if not (method.given_cameras if virtual else method.true_cameras)
        }

    def refuse_without_cameras(self, wildcards: Wildcards) -> None:
        """Raise StepError for what a cell without cameras does not have."""
        raise StepError(
            f"a cell of registration {methods.WITHOUT_CAMERAS} ends with its raw mesh, or with mesh.ply where that was generated: all else"
            f" needs cameras. Take one of {', '.join(self.registrations(wildcards.dataset))} in place of {methods.WITHOUT_CAMERAS}"
        )

    def capture_of(self, wildcards: Wildcards) -> str:
        """The capture that a registration reads, with every part of its path checked."""
        self.check_object(wildcards)
        if wildcards.registration == methods.WITHOUT_CAMERAS:
            self.refuse_without_cameras(wildcards)
        virtual = self.is_virtual(wildcards.dataset)
        kind, remedy = ("virtual", "") if virtual else ("photo", "Photos have no true cameras.")
        virtual_scenes = [*VIRTUAL_SCENES, BOARD_SCENE, TURNED_SCENE, JOINED_SCENE]
        scenes = virtual_scenes if virtual else [*PHOTO_SCENES, *LATER_PASSES, JOINED_PHOTOS]
        require_known(f"scene of a {kind} dataset", wildcards.scene, scenes)
        self.usable(f"registration of a {kind} dataset", wildcards.registration, self.registrations(wildcards.dataset), remedy)
        return f"{self.scene}/capture".format(**wildcards)

    def registration(self, wildcards: Wildcards) -> Method:
        """The registration that the path names. An unknown one is refused by `capture_of`."""
        return methods.REGISTRATIONS.get(wildcards.registration, next(iter(methods.REGISTRATIONS.values())))

    def registration_options(self, wildcards: Wildcards) -> str:
        """The options of this method; one that takes true cameras gets a seed only with options of its own."""
        options, method = self.section("register", wildcards.registration), self.registration(wildcards)
        if method.true_cameras and not options:
            return ""
        weights = f"--weights {methods.WEIGHTS_FOLDER / method.weights[0]} " if method.preset and not options.get("weights") else ""
        network = self.network_options(self.registration_network(wildcards))
        own = weights + self.options({**options, **network, "seed": self.config["seed"]})
        return f"{own} {self.verdict_option(wildcards)}".rstrip()

    def verdict_option(self, wildcards: Wildcards) -> str:
        """The option that says when estimated cameras are refused; none for true ones."""
        if self.registration(wildcards).true_cameras:
            return ""
        return self.options({"max_wrong_probability": self.config["register"]["max_wrong_probability"]})

    def registration_network(self, wildcards: Wildcards) -> Path | None:
        """The salient-object network by which the registration masks photos; None where it uses none, or the photos have masks."""
        masked = self.is_virtual(wildcards.dataset) or wildcards.scene == OBJECT_SCENE
        if masked or not self.registration(wildcards).saliency or self.row(wildcards)["masks"]:
            return None
        return self.salient_network()

    def registration_weights(self, wildcards: Wildcards) -> list[str]:
        """The files that the registration reads its networks from."""
        method = self.registration(wildcards)
        network = self.registration_network(wildcards)
        return self.weights_stamp("register", method, [network] if network else [])

    # Masks

    def mask_method(self, wildcards: Wildcards) -> str:
        """The method that gives photos their masks, before or after registration: the user's masks, or the one that the config chooses."""
        if self.row(wildcards)["masks"]:
            return GIVEN_MASKS
        name = self.config["segmentation"]
        if name != "auto":
            return self.usable("segmentation", name, self.segmentations)
        there = [name for name, method in self.segmentations.items() if not methods.lacks(method)]
        return next(name for name in there if not self.segmentations[name].saliency or self.salient_network())

    def masks(self, wildcards: Wildcards) -> Method:
        """What that method needs."""
        return methods.find_methods("segment")[self.mask_method(wildcards)]

    def segmentation(self, wildcards: Wildcards) -> str:
        """The method that gives registered photos their masks: the user's masks, or the one that the config chooses."""
        return GIVEN_MASKS if wildcards.scene == OBJECT_SCENE else self.mask_method(wildcards)

    def segmentation_options(self, wildcards: Wildcards) -> str:
        """The options of this method."""
        name = self.segmentation(wildcards)
        if name == GIVEN_MASKS:
            return self.options({"capture": f"{self.scene}/capture".format(**wildcards)})
        listed = self.of_owner(f"{self.run}/objects/objects.json")(wildcards)
        chosen = [self.options({"objects": path, "number": self.row(wildcards)["number"]}) for path in listed]
        return " ".join([self._segmentation_options(wildcards, name), *chosen])

    def _segmentation_options(self, wildcards: Wildcards, name: str) -> str:
        method, network = self.segmentations[name], self._mask_network(name)
        options = {**self.section("segment", name), **self.network_options(network), "seed": self.config["seed"]}
        if method.saliency:
            options["segmenter"] = shlex.quote(self._name_segmenter())
        if method.prompt:
            options["prompt"] = shlex.quote(self.row(wildcards)["prompt"] or options["prompt"])
        return self.options(options)

    def _mask_network(self, name: str) -> Path | None:
        return self.salient_network(needed=True) if self.segmentations[name].saliency else None

    def _name_segmenter(self) -> str:
        """Segment Anything as the step is given it: a name, or a file as seen from the working directory."""
        named = self.config["segment"]["saliency"]["segmenter"]
        return str(named if named in (DEFAULT, NONE) else self.relative(named))

    def segmentation_weights(self, wildcards: Wildcards) -> list[str]:
        """The files that this method reads its networks from."""
        name = self.mask_method(wildcards)
        if name == GIVEN_MASKS:
            return []
        segmenter = segmenter_path(self._name_segmenter()) if self.segmentations[name].saliency else None
        return self.weights_stamp("segment", self.segmentations[name], [path for path in (self._mask_network(name), segmenter) if path])

    def pictures_with_masks(self, wildcards: Wildcards) -> str:
        """The folder of photos and the masks to register them by: the capture, or a registered scene if masks are found only there."""
        scene = f"{self.object}/{WHOLE_SCENE}".format(**wildcards)
        registration = self.config["chosen"]["photos"]["registration"]
        return f"{scene}/{registration}/cameras" if self.masks(wildcards).in_scene else f"{scene}/capture"

    def object_options(self, wildcards: Wildcards) -> str:
        """The segmentation that finds masks before the registration, and its options, which come last; nothing if there are masks."""
        method = self.masks(wildcards)
        if method.given or method.in_scene:
            return ""
        return f"--segmentation {method.name} --options {self._segmentation_options(wildcards, method.name)}"
