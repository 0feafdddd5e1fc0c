"""The command `zeroshop`: from photos or a film of an object to its mesh, and a quick check of a capture."""

import argparse
import os
import sys
import time
import webbrowser
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from zeroshop_steps import __version__
from zeroshop_steps.methods import SURFACES
from zeroshop_steps.networks.salient_networks import DEFAULT, NETWORKS
from zeroshop_steps.runtime.errors import StepError, explain_machine_fault

DOCTOR = "Say which of the thesis's networks the card can hold, by its free memory, and what is missing."
HEIGHT_M = (0.005, 3.0)
MOST_PASSES = 3
PICTURES = (8, 1000)

DESCRIPTION = """\
Photos or a film of an object become a closed, textured mesh of true size.

  zeroshop mug.mp4 --height 0.096     a film; the mug is 9.6 cm high
  zeroshop photos/box                 a folder of photos; the size stays unknown
  zeroshop mug.mp4 turned.mp4         two films: for the second, the mug was turned over, so that its underside is seen
  zeroshop check photos/box           judge a capture in a minute, before anything long runs
  zeroshop doctor                     which networks the card can hold, and what is missing

Film the object once all around from the side and once from above, on a surface with print (a newspaper does), and keep it
whole in the picture. The results lie in results/photos/NAME below the current folder. A run that was interrupted goes on where it
stopped, and what is given again (a height, say) remakes only what depends on it.

Many objects, rendered test scenes and tables are made by Snakemake: see README.md."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    Args:
        argv: the command line without the program's name; the process's own by default.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    checking = words[:1] == ["check"]
    if words[:1] == ["doctor"]:
        argparse.ArgumentParser(prog="zeroshop doctor", description=DOCTOR).parse_args(words[1:])
        from zeroshop_steps.app.doctor import examine

        return examine()
    parser = _check_parser() if checking else _mesh_parser()
    if not words:
        parser.print_help()
        return 0
    args = parser.parse_args(words[1:] if checking else words)
    try:
        return _check(args) if checking else _make(args)
    except StepError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except (OSError, MemoryError) as error:
        print(f"error: {explain_machine_fault(error) or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ninterrupted; the same command goes on where it stopped", file=sys.stderr)
        return 130


def _mesh_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="zeroshop", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, nargs="+", metavar="PHOTOS_OR_FILM", help=(
        f"a folder of photos, or a video; up to {MOST_PASSES}, for which the object is turned over in between"))  # fmt: skip
    parser.add_argument("--height", type=float, metavar="METRES", help="height of the standing object, e.g. 0.19")
    parser.add_argument("--name", help="name of the results (default: that of the folder or video)")
    parser.add_argument(
        "--masks",
        type=Path,
        help="folder of masks, each named like its photo, such as x.png, x.jpg.png or x_mask.png (default: what is not transparent in the"
        " photos, masks among them, or they are found)",
    )
    parser.add_argument("--board", type=Path, nargs="?", const=Path(), metavar="PHOTOS", help=(
        "measure the height by the printed board beside the object, or in these photos of the empty scene"))  # fmt: skip
    parser.add_argument("--network", metavar="NAME_OR_FILE", help=(
        f"salient-object network that finds the object: {', '.join(NETWORKS)}, an ONNX file, or none (default: {DEFAULT})"))  # fmt: skip
    parser.add_argument("--count", type=int, metavar="N", help=(
        "frames to take of a film, or photos at most (default: 20, and more where a film needs them; 60 photos)"))  # fmt: skip
    names = list(SURFACES)
    parser.add_argument("--method", default=names[0], help=f"surface method: {' or '.join(names)} (default: %(default)s)")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 2, help="processor cores to use (default: all, %(default)s)")
    parser.add_argument("--into", type=Path, default=Path(), metavar="FOLDER", help="folder that gets results/ (default: the current one)")
    parser.add_argument("--open", action="store_true", help="open the report in a browser at the end")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _check_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="zeroshop check", description="Judge photos or a film before anything long runs.")
    parser.add_argument("source", type=Path, metavar="PHOTOS_OR_FILM", help="a folder of photos, or a video")
    return parser


def _check(args: argparse.Namespace) -> int:
    from zeroshop_steps.app.check import check_capture

    problems, warnings = check_capture(_require_source(args.source))
    for line in problems:
        print(f"problem   {line}")
    for line in warnings:
        print(f"warning   {line}")
    if not problems:
        print("ready     a mesh can be tried" if warnings else "ready     nothing speaks against a good mesh")
    return 1 if problems else 0


def _make(args: argparse.Namespace) -> int:
    from zeroshop_steps.app.captures import TABLE, Capture, add_capture, make_name
    from zeroshop_steps.app.workflow import JOINED_PHOTOS, count_more_frames, read_chosen_cell, run_workflow, settings_of_inputs

    sources = [_require_source(path) for path in args.source]
    if len(sources) > MOST_PASSES or len(set(sources)) < len(sources):
        raise StepError(f"{len(sources)} captures are given; expected up to {MOST_PASSES} different ones of one object")
    if args.masks and len(sources) > 1:
        raise StepError("--masks goes with one capture only; leave it out, masks of several passes are found")
    source = sources[0]
    if args.height is not None and not HEIGHT_M[0] <= args.height <= HEIGHT_M[1]:
        raise StepError(f"--height is {args.height:g}; it is in metres, {HEIGHT_M[0]:g} to {HEIGHT_M[1]:g}: write 0.19 for 19 cm")
    if args.count is not None and not PICTURES[0] <= args.count <= PICTURES[1]:
        raise StepError(f"--count is {args.count}; expected {PICTURES[0]} to {PICTURES[1]} frames or photos")
    if args.cores < 1:
        raise StepError(f"--cores is {args.cores}; at least 1 is needed")
    settings = settings_of_inputs(args.network)
    folder = args.into.resolve()
    by_board = args.board is not None
    capture = Capture(
        object=make_name(Path(args.name)) if args.name else make_name(source),
        images=str(source),
        **{f"images_{number}": str(path) for number, path in enumerate(sources[1:], start=2)},
        height_m=f"{args.height:g}" if args.height is not None else "",
        height_method="marker" if by_board else "known" if args.height is not None else "",
        marker_images=str(_require_folder(args.board, "--board")) if by_board and args.board != Path() else "",
        masks=str(_require_folder(args.masks, "--masks")) if args.masks else _find_own_masks(sources),
        picture_count=str(args.count or ""),
    )
    folder.mkdir(parents=True, exist_ok=True)
    capture = add_capture(folder, capture)
    results = folder / "results/photos" / capture.object
    print(f"{', '.join(map(str, sources))} -> {results}", file=sys.stderr)
    start_s = time.time()
    log = results / "logs/zeroshop.log"
    run = partial(run_workflow, f"results/photos/{capture.object}/{args.method}.ply", folder, folder / TABLE, args.cores, log, settings)
    done = run()
    scene, registration = read_chosen_cell(settings)
    if not (done or capture.picture_count or capture.images_2) and (count := count_more_frames(results / scene / registration)):
        print(f"The frames have no sure cameras; trying again with {count} of the film", file=sys.stderr)
        add_capture(folder, replace(capture, picture_count=str(count)))
        done = run()
    _print_outcome(results / (JOINED_PHOTOS if capture.images_2 else scene) / registration / args.method, log, done, start_s)
    if done and args.open:
        _open_report(folder, folder / TABLE, args.cores)
    return 0 if done else 1


def _print_outcome(cell: Path, log: Path, done: bool, start_s: float) -> None:
    from zeroshop_steps.app.summary import describe_advice, describe_mesh, describe_unseen, describe_warnings, find_reason, name_photos

    results = cell.parents[2]
    mesh = results / f"{cell.name}.ply"
    lines = [*describe_mesh(mesh), *describe_unseen(mesh)] if done else [f"Failed    {line}" for line in find_reason(log)]
    lines += describe_advice(cell, cell.parent / "cameras") + describe_warnings(results, start_s)
    lines = [name_photos(line, results) for line in lines]
    lines.append(f"Time      {(time.time() - start_s) / 60:.1f} min; everything that was said: {log}")
    print("\n".join(lines))


def _open_report(folder: Path, table: Path, cores: int) -> None:
    """Make the report of all objects so far and open it."""
    from zeroshop_steps.app.workflow import run_workflow

    index, log = folder / "results/photos/report/index.html", folder / "results/photos/report/logs/zeroshop.log"
    if run_workflow("results/photos/report/index.html", folder, table, cores, log):
        print(f"Report    {index}")
        webbrowser.open(index.as_uri())
    else:
        print(f"The report could not be made; see {log}", file=sys.stderr)


def _find_own_masks(sources: list[Path]) -> str:
    """The folder of the photos as that of their masks, where their background was removed, or masks lie among them."""
    from zeroshop_steps.capture.mask_names import split_masks
    from zeroshop_steps.capture.photo_files import is_cut_out, list_photos

    if len(sources) > 1 or not sources[0].is_dir():
        return ""
    if masks := split_masks(list_photos(sources[0])[0])[1]:
        print(f"Masks lie among the photos and are taken, such as {masks[0].name}", file=sys.stderr)
    elif is_cut_out(sources[0]):
        print("The background of the photos is transparent: what is left of them is taken as masks", file=sys.stderr)
    else:
        return ""
    return str(sources[0])


def _require_source(path: Path) -> Path:
    """The absolute path of a capture that exists."""
    if not path.exists():
        raise StepError(f"{path} does not exist; name a folder of photos or a video")
    return path.resolve()


def _require_folder(path: Path, option: str) -> Path:
    if not path.is_dir():
        raise StepError(f"{option} names {path}, which is no folder")
    return path.resolve()
