"""Score detections as BOP does: COCO's average precision over IoU 0.5 to 0.95, of masks or of boxes.

Reads a BOP COCO result file (.json or .json.gz), the targets and the scenes with their masks. Writes a tidy CSV.
"""

import argparse
from pathlib import Path

from zeroshop_steps.bop.detections import read_detections
from zeroshop_steps.bop.precision import average_precision
from zeroshop_steps.bop.score_poses import write_rows
from zeroshop_steps.bop.targets import read_target_frames, read_targets

KINDS = {"masks": "segm", "boxes": "bbox"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--detections", type=Path, required=True, help="BOP COCO result file")
    parser.add_argument("--targets", type=Path, required=True, help="test_targets_bop19.json")
    parser.add_argument("--scenes", type=Path, required=True, help="the split's folder, which holds 000001 and so on")
    parser.add_argument("--of", choices=KINDS, default="masks", help="what is compared (default: %(default)s)")
    parser.add_argument("--modal-boxes", action="store_true", help="true boxes around the visible part, not the whole silhouette")
    parser.add_argument("--out", type=Path, required=True, help="CSV of the scores")


def run(args: argparse.Namespace) -> None:
    """Score one result file."""
    frames = read_target_frames(args.scenes, targets := read_targets(args.targets), args.targets)
    detections = read_detections(args.detections)
    scores = average_precision(detections, frames, KINDS[args.of], not args.modal_boxes, args.detections)
    rows = []
    for name, value in scores.items():
        measure, _, number = name.partition("_object_")
        rows.append({"measure": measure, "object": number, "value": value})
    rows.append({"measure": "instances", "object": "", "value": sum(target.inst_count for target in targets)})
    rows.append({"measure": "detections", "object": "", "value": len(detections)})
    write_rows(args.out, rows)
    print(", ".join(f"{name} {scores[name]:.4f}" for name in ("ap", "ap_50", "ap_75")))
