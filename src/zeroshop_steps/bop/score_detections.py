"""Score detections as BOP does: COCO's average precision over IoU 0.5 to 0.95 of masks (`ap`) and of boxes (`box_ap`).

Reads a BOP COCO result file (.json or .json.gz), the targets and the scenes with their masks (boxes do without them if
scene_gt_info.json is there). Writes a tidy CSV.
"""

import argparse
from pathlib import Path

from zeroshop_steps.bop.formats.detections import read_detections
from zeroshop_steps.bop.formats.targets import read_target_frames, read_targets, size_finder
from zeroshop_steps.bop.score_poses import ROW
from zeroshop_steps.bop.scoring.precision import average_precision
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.tables import write_table

KINDS = {"masks": ("segm", ""), "boxes": ("bbox", "box_")}
"""COCO's name of what is compared, and the prefix of its measures."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--detections", type=Path, required=True, help="BOP COCO result file")
    parser.add_argument("--targets", type=Path, required=True, help="test_targets_bop19.json")
    parser.add_argument("--scenes", type=Path, required=True, help="the split's folder, which holds 000001 and so on")
    parser.add_argument("--of", choices=KINDS, nargs="+", default=["masks"], help="what is compared (default: masks)")
    parser.add_argument("--modal-boxes", action="store_true", help="true boxes around the visible part instead of the whole silhouette")
    parser.add_argument("--out", type=Path, required=True, help="CSV of the scores")


def run(args: argparse.Namespace) -> None:
    """Score one result file."""
    frames = read_target_frames(args.scenes, targets := read_targets(args.targets), args.targets)
    detections = read_detections(args.detections, size_finder(frames))
    if not detections:
        warn(f"{args.detections} holds no detections; every object counts as not found")
    asked = {(target.scene_id, target.im_id, target.obj_id) for target in targets}
    if detections and not any((found.scene_id, found.image_id, found.object_id) in asked for found in detections):
        first = detections[0]
        raise StepError(
            f"{args.detections}: none of the {len(detections)} detections names a target of {args.targets}; the first names scene"
            f" {first.scene_id}, image {first.image_id}, object {first.object_id}. Both must belong to one test set, and count alike"
        )
    rows: list[dict] = []
    summary = []
    for kind in args.of:
        coco_name, prefix = KINDS[kind]
        scores = average_precision(detections, frames, coco_name, not args.modal_boxes, args.detections)
        for name, value in scores.items():
            measure, _, number = name.partition("_object_")
            rows.append({"measure": prefix + measure, "object": number, "value": value})
        summary += [f"{prefix}{name} {scores[name]:.4f}" for name in ("ap", "ap_50", "ap_75")]
    rows.append({"measure": "instances", "object": "", "value": sum(target.inst_count for target in targets)})
    rows.append({"measure": "detections", "object": "", "value": len(detections)})
    write_table(args.out, rows, ROW)
    print(", ".join(summary))
