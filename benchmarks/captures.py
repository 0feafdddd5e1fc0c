"""Benchmark of captures: what comes out of photos and films as people take them, beside what must come out. See docs/benchmark.md.

A capture that was done is not run again unless its inputs, the options or the code changed: an interrupted run goes on where it stopped.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from capture_benchmark.inputs import make_inputs
from capture_benchmark.mask_stage import PICTURE, MaskCommand, judge_masks, run_masks
from capture_benchmark.mesh_stage import MASK_PICTURE, MESH_PICTURE, judge_mesh, run_all
from capture_benchmark.results import PAGE, TABLE, summarize, write_results
from capture_benchmark.table import HALVES, Capture, choose_captures, read_captures
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.runtime.errors import StepError

HERE = Path(__file__).parent
STAGES = {"inputs": [], "masks": [PICTURE], "all": [MESH_PICTURE, MASK_PICTURE]}
"""What can be run, and the pictures that each draws."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status: 1 where something cannot be run, 0 else, however the captures end."""
    args = parse_arguments(argv)
    try:
        captures = choose_captures(read_captures(args.table), args.half, args.only)
        return run(captures, args)
    except StepError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ninterrupted; the same command goes on where it stopped", file=sys.stderr)
        return 130


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", type=Path, default=HERE / "captures/captures.csv", help="table of captures (default: %(default)s)")
    parser.add_argument("--data", type=Path, required=True, help="folder that the table's paths start from")
    parser.add_argument("--references", type=Path, default=HERE / "captures/masks", help="folder of drawn masks (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results: results.csv, index.html, and a folder a capture")
    parser.add_argument("--inputs", type=Path, help="folder of stored captures and scenes (default: inputs in the folder of the results)")
    parser.add_argument("--weights", type=Path, default=Path(WEIGHTS_FOLDER), help="folder of networks (default: %(default)s)")
    stages_help = "inputs alone; masks of stored scenes; or all, from photos to meshes (default: %(default)s)"
    parser.add_argument("--stages", choices=list(STAGES), default="masks", help=stages_help)
    parser.add_argument("--half", choices=(*HALVES, "both"), default="both", help="which captures (default: %(default)s)")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="these captures alone")
    parser.add_argument("--method", default="saliency", help="of segment, for the stage of masks (default: %(default)s)")
    options_help = "further options of this method, or for all stages of zeroshop; they come last"
    parser.add_argument("--options", nargs=argparse.REMAINDER, default=[], help=options_help)
    parser.add_argument("--earlier", type=Path, help="a results table of before: what got worse since comes first")
    parser.add_argument("--jobs", type=int, default=1, help="captures at a time, each with one thread if several (default: %(default)s)")
    return parser.parse_args(argv)


def run(captures: list[Capture], args: argparse.Namespace) -> int:
    """Make what is asked of these captures."""
    inputs = args.inputs or args.out / "inputs"
    command = MaskCommand(args.method, tuple(args.options), 1 if args.jobs > 1 else 0)
    failed: list[str] = []
    rows: dict[str, dict[str, Any]] = {}

    def make(capture: Capture) -> None:
        try:
            make_inputs(capture, args.data, inputs, args.weights, 2, with_scene=args.stages != "all")
            if args.stages == "inputs":
                return
            out = args.out / capture.name
            if args.stages == "all":
                facts = run_all(capture, command.options, args.data, inputs, max(2 // args.jobs, 1), out)
                rows[capture.name] = judge_mesh(capture, facts, args.data, inputs, args.references, out)
            else:
                facts = run_masks(capture, command, inputs, out)
                rows[capture.name] = judge_masks(capture, command, facts, args.data, inputs, args.references, out)
            print(_describe(rows[capture.name]), flush=True)
        except StepError as error:
            failed.append(f"{capture.name}: {error}")
            print(f"{capture.name}: {error}", file=sys.stderr)

    _run_all(make, captures, args.jobs)
    if rows:
        ordered = [rows[capture.name] for capture in captures if capture.name in rows]
        worse = write_results(ordered, args.out, STAGES[args.stages], args.earlier)
        for name, words in worse:
            print(f"worse: {name}: {'; '.join(words)}")
        for row in summarize(ordered):
            print(", ".join(f"{name} {value}" for name, value in row.items() if value not in (None, 0)))
        print(f"{args.out / TABLE}, {args.out / PAGE}")
    return 1 if failed else 0


def _run_all(make: Callable[[Capture], None], captures: list[Capture], jobs: int) -> None:
    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        for _ in pool.map(make, captures):
            pass


def _describe(row: dict[str, Any]) -> str:
    figures = [
        f"{row[name]:.3f}"
        for name in ("mask_iou_median", "mask_iou_worst", "mesh_iou_median", "mesh_iou_worst")
        if row.get(name) is not None
    ]
    return (
        f"{row['name']}: {row['outcome']} {' '.join(figures)} ({row['wall_s']:.0f} s){' ' + row['reason'][:200] if row['reason'] else ''}"
    )


if __name__ == "__main__":
    sys.exit(main())
