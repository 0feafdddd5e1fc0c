"""Say where to look next: of a capture with known cameras and depth, the views that add most, and whether it is enough.

For arms that are driven by other programs: record views into the common form in any way, then ask. Writes a JSON with `enough`, `reason`
and `proposals`, each with `gain`, in shares of the known surface, and `world_from_camera` in metres, OpenCV's axes.
"""

import argparse
import sys
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.scan.recorder import ScanRecorder
from zeroshop_steps.scan.setup import add_setup_arguments, make_reach, make_scan


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--capture", type=Path, required=True, help="folder with cameras.json, images/ and depth/")
    add_setup_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, help="JSON to write")


def run(args: argparse.Namespace) -> None:
    """Write the advice."""
    recorder = ScanRecorder(args.capture, "")
    if not recorder.views:
        raise StepError(f"{args.capture} has no view with a pose yet; record a first one, from any side")
    advice = make_scan(args, recorder, recorder.views[-1].lens).propose(make_reach(args))
    proposals = [{"gain": round(one.gain, 4), "world_from_camera": one.move.world_from_camera.tolist()} for one in advice.proposals]
    write_json(args.out, {"enough": advice.enough, "reason": advice.reason, "proposals": proposals})
    print(f"{args.out}: {advice.reason}", file=sys.stderr)
