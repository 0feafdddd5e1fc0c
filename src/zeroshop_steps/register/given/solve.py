"""From given cameras and pictures to checked cameras."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.capture.cameras_json import LEAST_POSES, GivenCameras
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.support.scene_support import find_focus
from zeroshop_steps.register.colmap import ColmapOptions, match_images
from zeroshop_steps.register.features.sift import fit_to_count
from zeroshop_steps.register.final_checks import FinalChecks
from zeroshop_steps.register.final_refinement import Hypothesis
from zeroshop_steps.register.given.adjustment import LEAST_POINTS, adjust, align, measure_shifts, take_poses, triangulate
from zeroshop_steps.register.given.conventions import find_fault, read_pairs
from zeroshop_steps.register.mapping.reregistration import register_again
from zeroshop_steps.register.pipeline import leave_out_culprits, write_checked
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.record import Inconsistent, Record, Stopwatch
from zeroshop_steps.register.verification.consistency import ConsistencyReport, check_consistency
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import scratch_directory

DISTANCE_M = (0.01, 30.0)  # of a camera from what all look at; beyond, another unit was meant
FEW_OBSERVATIONS = 100
"""Points seen by an image, in the mean: with fewer, the pictures neither move nor confirm given cameras, and that is told."""


@dataclass(frozen=True)
class _Scene:
    """What is adjusted to: the pictures, their matches, and what was given."""

    image_set: ImageSet
    given: GivenCameras
    database: Path
    options: ColmapOptions

    def check(self, model: pycolmap.Reconstruction) -> ConsistencyReport:
        """A model against masks and matches. That few matches hold cameras does not speak against given ones."""
        structure = self.options.structure
        limits = replace(structure.limits, cut_matches=0, least_points=LEAST_POINTS)
        return check_consistency(model, self.image_set, self.database, limits, structure.doubt_masks)

    def place(self, model: pycolmap.Reconstruction, names: list[str]) -> pycolmap.Reconstruction:
        """The images `names` placed among the others of a model, by their matches alone; the rest stays in the given frame."""
        again = register_again(
            model, names, self.database, self.image_set.images[0].parent, self.database.parent, self.options.structure.seed, True
        )
        align(again, self.given)
        return again


def register(image_set: ImageSet, given: GivenCameras, out: Path, options: ColmapOptions) -> dict[str, Any]:
    """Adjust and check the given cameras, and write images/, sparse/ and, where there are masks, masks/ to `out`.

    Returns:
        The record for registration.json.

    Raises:
        RegistrationFailed: the pictures contradict the cameras; says how these are meant, if a usual misreading explains it.
        StepError: an image has no lens, or too few have poses.
    """
    names = image_set.names
    given.require(names)
    poses = {name: pose for name, pose in given.poses.items() if name in names}
    if len(poses) < LEAST_POSES:
        raise StepError(
            f"{len(poses)} of {len(names)} images have a given pose, {LEAST_POSES} are needed; let cameras be estimated (colmap) instead"
        )
    options = replace(options, sift=fit_to_count(options.sift, len(names)))
    record = Record.begin("given", image_set, options, pycolmap).warn(*given.warnings)
    lenses = {name: given.images[name].lens.to_colmap() for name in names}
    _check_distance(record, given, poses, lenses)
    with scratch_directory(out, "given") as scratch:
        scene = _Scene(image_set, given, scratch / "database.db", options)
        graph = match_images(scene.database, image_set, options, record.stopwatch, {Path(name).stem: lens for name, lens in lenses.items()})
        record = record.judge(graph.evidence())
        support, fault = find_fault(poses, read_pairs(scene.database, lenses), names)
        facts = {
            "source": given.source,
            "metric": given.metric,
            "known": len(poses),
            "support": None if support is None else round(support, 3),
        }
        record = record.add(given=facts)
        if fault:
            raise record.fail(f"the given cameras ({given.source}) are refused: {fault}", kind=Inconsistent)
        record.stopwatch.lap("understand")
        # Keypoints are not aligned by the pictures as for `colmap`: of a bottle on print, cameras are 0.07 mm off without, 0.08 with.
        model = _adjust_in_rounds(scene, poses, record.stopwatch)
        hypothesis = Hypothesis(model, scene.check(model))
        hypothesis = leave_out_culprits(hypothesis, options.structure, scene.place, partial(adjust, given=given), scene.check)
        record = record.add(placed_again=list(hypothesis.placed_again), left_out=list(hypothesis.left_out))
        record = _tell_shifts(record, hypothesis.model, given, image_set)
        asked = FinalChecks(out, scene.database, graph.may_match(), False, options.structure.seed, True)
        return dict(write_checked(hypothesis, image_set, asked, record).entries)


def _check_distance(record: Record, given: GivenCameras, poses: dict[str, np.ndarray], lenses: dict[str, pycolmap.Camera]) -> None:
    """Raise RegistrationFailed where cameras that are said to be metric stand as far from what they look at as no hand-held object is."""
    if not given.metric:
        return
    cameras = [
        Camera(name, lenses[name].width, lenses[name].height, np.array(lenses[name].calibration_matrix()), pose)
        for name, pose in poses.items()
    ]
    try:
        focus = find_focus(cameras)
    except StepError:  # they look away from each other; the matches tell why
        return
    distance_m = float(np.median([np.linalg.norm(camera.centre_in_world - focus) for camera in cameras]))
    if not DISTANCE_M[0] <= distance_m <= DISTANCE_M[1]:
        hint = (
            "they seem to be in millimetres: divide their translations by 1000" if distance_m > DISTANCE_M[1] else "another unit is meant"
        )
        raise record.fail(
            f"the given cameras ({given.source}) are refused: they stand {distance_m:.4g} m from what they look at; {hint}",
            kind=Inconsistent,
        )


def _adjust_in_rounds(scene: _Scene, poses: dict[str, np.ndarray], stopwatch: Stopwatch) -> pycolmap.Reconstruction:
    """The given cameras, and what they see, adjusted to the pictures; those without a pose are placed among them."""
    seed = scene.options.structure.seed
    rigid = {name: pycolmap.Rigid3d(pose[:3]) for name, pose in poses.items()}
    model = triangulate(scene.database, scene.image_set, rigid, seed, rough=True)
    adjust(model, scene.given)
    model = triangulate(scene.database, scene.image_set, take_poses(model), seed, rough=False)
    adjust(model, scene.given)
    stopwatch.lap("adjust")
    if len(poses) < len(scene.image_set.names):
        model = scene.place(model, [])
        adjust(model, scene.given)
        stopwatch.lap("complete")
    return model


def _tell_shifts(record: Record, model: pycolmap.Reconstruction, given: GivenCameras, image_set: ImageSet) -> Record:
    """With the shifts of the cameras, and a warning where hardly any picture confirms them."""
    shifts = measure_shifts(model, given)
    record = record.add(given={**record.entries["given"], **shifts.figures()}).warn(*shifts.warnings(image_set.shown))
    seen = model.compute_mean_observations_per_reg_image() if model.num_points3D() else 0.0
    if seen >= FEW_OBSERVATIONS:
        return record
    return record.warn(
        f"an image sees {seen:.0f} points in the mean: too little print to confirm the given cameras, which are taken as they were stated"
    )
