"""Score estimated poses as the BOP Challenge does: average recall of VSD, MSSD and MSPD, and their mean AR_D.

Reads a BOP result CSV, the targets, the scenes with their truth, and the true models (BOP's models_eval). Writes a tidy CSV with one
row per measure, over all objects and for each; with --errors-out also the errors of every estimate.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from zeroshop_steps.bop.estimates import Estimates, read_estimates
from zeroshop_steps.bop.models import list_objects, read_models
from zeroshop_steps.bop.recall import ERRORS, PosePairs, average_recall, measure_pose_errors, pair_up
from zeroshop_steps.bop.targets import Target, read_target_frames, read_targets
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import write_table

ROW = ("measure", "object", "value")
ERROR_ROW = ("scene_id", "im_id", "obj_id", "estimate", "score", "instance")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--estimates", type=Path, required=True, help="BOP result CSV")
    parser.add_argument("--targets", type=Path, required=True, help="test_targets_bop19.json")
    parser.add_argument("--scenes", type=Path, required=True, help="the split's folder, which holds 000001 and so on")
    parser.add_argument("--models", type=Path, required=True, help="folder of the true models with models_info.json")
    parser.add_argument("--errors", nargs="+", choices=ERRORS, default=list(ERRORS), help="pose errors (default: all)")
    parser.add_argument("--delta-mm", type=float, default=15.0, help="tolerance of visibility in VSD (default: %(default)s, as in BOP)")
    parser.add_argument("--image-width", type=int, help="width of the images in px, if the scenes have no images")
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
    size = next((size for frame in frames.values() if (size := frame.size_px())), None)
    width_px = size[0] if size else args.image_width
    errors = measure_pose_errors(pairs, estimates, targets, frames, models, args.errors, width_px, args.delta_mm)
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


def check_objects(estimates: Estimates, args: argparse.Namespace) -> None:
    """Raise StepError if an estimate names an object that has no model."""
    strange = sorted(set(estimates.object_ids.tolist()) - set(there := list_objects(args.models)))
    if strange:
        raise StepError(
            f"{args.estimates}: estimates name the objects {strange}, which have no model in {args.models}; it has {there}."
            " Score estimates with the models of their dataset"
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
