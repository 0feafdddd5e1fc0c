"""Score estimated poses as the BOP Challenge does: average recall of VSD, MSSD and MSPD, and their mean AR_D.

Reads a BOP result CSV, the targets, the scenes with their truth, and the true models (BOP's models_eval). Writes a tidy CSV with one
row per measure, over all objects and for each; with --errors-out also the errors of every estimate.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.estimates import Estimates, read_estimates
from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.bop.formats.targets import Frames, Target, read_target_frames, read_targets
from zeroshop_steps.bop.scoring.recall import ERRORS, PosePairs, average_recall, measure_pose_errors, pair_up
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.tables import write_table

OTHER_UNIT = 4.0
"""Ratio of median distances from which estimates are taken for ones in another unit; the nearest unit differs by 10."""
UNITS_MM = {"micrometres": 1e-3, "tenths of millimetres": 0.1, "centimetres": 10.0, "inches": 25.4, "metres": 1e3}
ROW = ("measure", "object", "value")
ERROR_ROW = ("scene_id", "im_id", "obj_id", "estimate", "score", "instance")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--estimates", type=Path, required=True, help="BOP result CSV")
    parser.add_argument("--targets", type=Path, required=True, help="test_targets_bop19.json")
    parser.add_argument("--scenes", type=Path, required=True, help="the split's folder, which holds 000001 and so on")
    parser.add_argument("--models", type=Path, required=True, help="folder of the true models with models_info.json")
    parser.add_argument("--errors", nargs="+", choices=ERRORS, help="pose errors (default: all; without depth images, no vsd)")
    parser.add_argument("--delta-mm", type=float, default=15.0, help="tolerance of visibility in VSD (default: %(default)s, as in BOP)")
    parser.add_argument("--image-width", type=int, help="width of the images in px, if the scenes have no images")
    parser.add_argument("--camera", type=Path, help="camera.json that has this width")
    parser.add_argument("--errors-out", type=Path, help="CSV of the errors of every estimate")
    parser.add_argument("--out", type=Path, required=True, help="CSV of the scores")


def run(args: argparse.Namespace) -> None:
    """Score one result file."""
    targets = read_targets(args.targets)
    frames = read_target_frames(args.scenes, targets, args.targets)
    models = read_models(args.models, {target.obj_id for target in targets})
    estimates = read_estimates(args.estimates)
    check_objects(estimates, args)
    pairs = pair_up(estimates, targets, frames)
    check_estimates(estimates, targets, frames, args)
    size = next((size for frame in frames.values() if (size := frame.size_px())), None)
    width_px = size[0] if size else args.image_width or (read_json(args.camera).get("width") if args.camera else None)
    errors = measure_pose_errors(pairs, estimates, targets, frames, models, choose_errors(args, frames), width_px, args.delta_mm)
    recall = average_recall(pairs, errors, targets)
    rows = [{"measure": measure, "object": "", "value": value} for measure, value in recall.overall.items()]
    rows.append({"measure": "instances", "object": "", "value": sum(recall.targets.values())})
    rows.append({"measure": "estimates", "object": "", "value": len(estimates)})
    rows.append({"measure": "seconds_per_image", "object": "", "value": estimates.seconds_per_image()})
    for number, measures in recall.by_object.items():
        measures = {**measures, "instances": recall.targets[number]}
        rows += [{"measure": measure, "object": number, "value": value} for measure, value in measures.items()]
    write_table(args.out, rows, ROW)
    if args.errors_out:
        write_table(args.errors_out, make_error_rows(pairs, errors, estimates, targets), [*ERROR_ROW, *errors])
    print(", ".join(f"{name} {value:.4f}" for name, value in recall.overall.items()))


def choose_errors(args: argparse.Namespace, frames: Frames) -> list[str]:
    """The errors that are asked for; by default all, but VSD only where any image has depth, which it compares with."""
    if args.errors:
        return list(args.errors)
    if any(frame.image_path("depth") for frame in frames.values()):
        return list(ERRORS)
    warn(f"{args.scenes} has no depth images: VSD, and with it AR, is left out")
    return [kind for kind in ERRORS if kind != "vsd"]


def check_objects(estimates: Estimates, args: argparse.Namespace) -> None:
    """Raise StepError if an estimate names an object that has no model."""
    strange = sorted(set(estimates.object_ids.tolist()) - set(there := list_objects(args.models)))
    if strange:
        raise StepError(
            f"{args.estimates}: estimates name the objects {strange}, which have no model in {args.models}; it has {there}."
            " Score estimates with the models of their dataset"
        )


def check_estimates(estimates: Estimates, targets: Sequence[Target], frames: Frames, args: argparse.Namespace) -> None:
    """Look for mistakes that would give every estimate the score 0; rows that name no target are warned of where others do.

    Raises:
        StepError: no row names a target, or objects are so near or so far that the unit must be another one.
    """
    asked = {(target.scene_id, target.im_id, target.obj_id) for target in targets}
    rows = list(zip(estimates.scene_ids.tolist(), estimates.image_ids.tolist(), estimates.object_ids.tolist(), strict=True))
    used = np.array([row in asked for row in rows], bool)
    if not len(rows):
        return
    if not used.any():
        scene_id, image_id, object_id = rows[0]
        raise StepError(
            f"{args.estimates}: none of the {len(rows)} rows names a target of {args.targets}; the first row names scene {scene_id}, image"
            f" {image_id}, object {object_id}. Estimates and targets must belong to the same test set, and count scenes and images alike"
        )
    if not used.all():
        warn(f"{args.estimates}: {(~used).sum()} of {len(rows)} rows name no target of {args.targets}, and do not count")
    true_mm = np.median([
        np.linalg.norm(instance.camera_from_model[:3, 3])
        for frame in frames.values() for instance in frame.instances if (frame.scene_id, frame.image_id, instance.object_id) in asked
    ])  # fmt: skip
    found_mm = np.median(np.linalg.norm(estimates.translations_mm[used], axis=1))
    if not 1 / OTHER_UNIT < found_mm / true_mm < OTHER_UNIT:
        unit = min(UNITS_MM, key=lambda name: abs(np.log(found_mm * UNITS_MM[name] / true_mm)))
        raise StepError(
            f"{args.estimates}: objects are {found_mm:.4g} from the camera in the median, the true ones {true_mm:.4g} mm;"
            f" t looks like {unit}, millimetres are expected"
        )


def make_error_rows(pairs: PosePairs, errors: dict, estimates: Estimates, targets: Sequence[Target]) -> list[dict]:
    """One row per pair of an estimate and an instance: MSSD in diameters, MSPD in px at a width of 640, mean VSD."""
    rows = []
    for index, (target, row) in enumerate(zip(pairs.target, pairs.estimate, strict=True)):
        found = targets[target]
        rows.append(
            {"scene_id": found.scene_id, "im_id": found.im_id, "obj_id": found.obj_id, "estimate": row, "score": estimates.scores[row]}
            | {"instance": pairs.instance[index]}
            | {kind: float(values[index].mean()) for kind, values in errors.items()}
        )
    return rows
