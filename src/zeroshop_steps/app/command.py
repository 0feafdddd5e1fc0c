"""The command `zeroshop`: from photos or a film of an object to its mesh, and to what robots make of it."""

import os
import sys
import tempfile
import time
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from zeroshop_steps import __version__
from zeroshop_steps.methods import SURFACES
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT, NETWORKS
from zeroshop_steps.runtime.errors import StepError, explain_machine_fault

DESCRIPTION = """\
Photos or a film of an object become a closed, textured mesh of true size.

\b
  zeroshop mug.mp4 --height 0.096     a film; the mug is 9.6 cm high
  zeroshop photos/box                 a folder of photos; the size stays unknown
  zeroshop mug.mp4 turned.mp4         two films: for the second, the mug was turned over, so that its underside is seen
  zeroshop nerfstudio/mug             a capture with known cameras: nerfstudio, COLMAP, BOP and others (zeroshop import --help)
  zeroshop check photos/box           judge a capture in a minute, before anything long runs
  zeroshop export urdf mug            the mesh that was made, for robots and simulators

Film the object once all around from the side and once from above, on a surface with print (a newspaper does), and keep it
whole in the picture. The results lie in results/photos/NAME below the current folder. A run that was interrupted goes on where
it stopped, and what is given again (a height, say) remakes only what depends on it.

Many objects, rendered test scenes and tables are made by Snakemake: see README.md, and `zeroshop workflow init`."""
METHODS = list(SURFACES)
WIDTH = 120  # of the help


class DefaultGroup(click.Group):
    """A group whose first word may be left out: what is no command is given to `mesh`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put `mesh` before what is no command."""
        if args and args[0] not in self.commands and args[0] not in ("--help", "--version"):
            args = ["mesh", *args]
        return super().parse_args(ctx, args)


@click.group(cls=DefaultGroup, help=DESCRIPTION, no_args_is_help=False, invoke_without_command=True)
@click.version_option(__version__, prog_name="zeroshop", message="%(prog)s %(version)s")
@click.pass_context
def zeroshop(ctx: click.Context) -> None:
    """Print the help where nothing is asked for."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def _run_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of all commands that run the workflow."""
    for option in (
        click.option("--into", type=click.Path(path_type=Path), default=Path(), metavar="FOLDER", help="Folder that gets results/.",
                     show_default="the current one"),
        click.option("--cores", type=int, metavar="N", default=os.cpu_count() or 2, help="Processor cores to use.", show_default="all"),
    ):  # fmt: skip
        command = option(command)
    return command


_of_mesh = click.option("--method", default=METHODS[0], show_default=True, help=f"Surface method: {' or '.join(METHODS)}.")


@zeroshop.command()
@click.argument("sources", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="PHOTOS_OR_FILM...")
@click.option("--height", "height_m", type=float, metavar="METRES", help="Height of the standing object, such as 0.19.")
@click.option("--name", default="", help="Name of the results.", show_default="that of the folder or film")
@click.option("--masks", type=click.Path(path_type=Path), metavar="FOLDER", help=(
    "Folder of masks, each named like its photo, such as x.png, x.jpg.png or x_mask.png. By default, what is not transparent in the"
    " photos, or masks among them; else they are found."))  # fmt: skip
@click.option("--board", is_flag=False, flag_value="", metavar="[PHOTOS]", help=(
    "Measure the height by the printed board beside the object, or in these photos of the empty scene."))  # fmt: skip
@click.option("--network", metavar="NAME_OR_FILE", show_default=DEFAULT, help=(
    f"Salient-object network that finds the object: {', '.join(NETWORKS)}, an ONNX file, or none."))  # fmt: skip
@click.option("--count", type=int, metavar="N", help="Frames to take of a film, or photos at most.",
              show_default="20, and more where a film needs them; 60 photos")  # fmt: skip
@click.option("--objects", metavar="all|N|1,4", help=(
    "Make a mesh of each of several objects in the photos: of all, of the N likeliest, or of these numbers."))  # fmt: skip
@click.option("--open", "opens", is_flag=True, help="Open the report in a browser at the end.")
@_run_options
@_of_mesh
def mesh(board: str | None, objects: str | None, opens: bool, cores: int, **asked: Any) -> int:
    """Make the mesh of an object from its photos or films.

    Give up to three, for which the object is turned over in between. The command's name may be left out: `zeroshop photos/mug`.
    """
    from zeroshop_steps.app.reconstruct_object import Request, make_mesh
    from zeroshop_steps.app.several_objects import make_meshes

    start_s, done = time.time(), []
    request = Request(board=board is not None, board_photos=Path(board) if board else None, cores=cores, **asked)
    for outcome in make_meshes(request, objects) if objects else [make_mesh(request)]:
        print("\n".join(outcome.describe(start_s)))
        done.append(outcome.done)
    if all(done) and opens:
        _make_report(outcome.folder, outcome.cores, True)
    return 0 if all(done) else 1


@zeroshop.command()
@click.argument("source", type=click.Path(path_type=Path), metavar="PHOTOS_OR_FILM")
def check(source: Path) -> int:
    """Judge photos or a film in a minute, before anything long runs."""
    from zeroshop_steps.app.check import check_capture
    from zeroshop_steps.app.importing import find_source
    from zeroshop_steps.app.reconstruct_object import require_source

    with tempfile.TemporaryDirectory() as folder:  # what other programs wrote is imported there
        problems, warnings = check_capture(find_source(require_source(source), Path(folder), "checked").images)
    for line in problems:
        print(f"problem   {line}")
    for line in warnings:
        print(f"warning   {line}")
    if not problems:
        print("ready     a mesh can be tried" if warnings else "ready     no problems found")
    return 1 if problems else 0


@zeroshop.command()
@click.argument("kind")
@click.argument("name")
@_run_options
@_of_mesh
def export(kind: str, name: str, method: str, cores: int, into: Path) -> int:
    """Export a mesh that was made: urdf, mjcf, usd, usdz, body, foundationpose, nerfstudio, colmap or bop."""
    from zeroshop_steps.app.reconstruct_object import find_outcome

    print(f"Export    {find_outcome(name, method, into, cores).export(kind)}")
    return 0


@zeroshop.command()
@click.argument("name")
@_run_options
@_of_mesh
def grasp(name: str, method: str, cores: int, into: Path) -> int:
    """Find grasps of a mesh that was made, with a picture of them."""
    from zeroshop_steps.app.reconstruct_object import find_outcome

    outcome = find_outcome(name, method, into, cores)
    print(f"Grasps    {outcome.make(outcome.cell / 'grasps.json')}\n          {outcome.make(outcome.cell / 'grasps.png')}")
    return 0


@zeroshop.command()
@click.option("--open", "opens", is_flag=True, help="Open it in a browser.")
@_run_options
def report(opens: bool, cores: int, into: Path) -> int:
    """Make the report of all objects so far."""
    return 0 if _make_report(into.resolve(), cores, opens) else 1


@zeroshop.command("import")
@click.argument("source", type=click.Path(path_type=Path), metavar="PATH")
@click.option("--out", type=click.Path(path_type=Path), required=True, metavar="FOLDER", help="Folder to write.")
@click.option("--unit", type=click.Choice(["m", "mm", "unknown"]), help="Unit of the poses.", show_default="what the format says")
@click.option("--object", "object_id", type=int, metavar="ID", help="The object's number, where several are annotated (BOP).")
@click.option("--board", metavar="NAME_OR_FILE", help="The board around the object, which gives the cameras: a4, a3, or a file.")
@click.option("--topic", metavar="NAME", help="Of a bag's colour images.", show_default="those with most pixels")
@click.option("--position-deviation", type=click.FloatRange(0, min_open=True), metavar="METRES", help=(
    "Standard deviation of the cameras' places along each axis, such as 0.001 for a robot's arm."))  # fmt: skip
@click.option("--rotation-deviation", type=click.FloatRange(0, min_open=True), metavar="DEGREES", help="That of their turns.")
def import_(
    source: Path,
    out: Path,
    unit: str | None,
    object_id: int | None,
    board: str | None,
    topic: str | None,
    position_deviation: float | None,
    rotation_deviation: float | None,
) -> int:
    """Bring a capture with known cameras into the common form: COLMAP, nerfstudio, instant-ngp, BOP, FoundationPose, bags."""
    from zeroshop_steps.app.importing import import_capture
    from zeroshop_steps.app.reconstruct_object import require_source
    from zeroshop_steps.capture.adapters.form import ImportOptions

    what = import_capture(require_source(source), out, ImportOptions(unit, object_id, board, topic), position_deviation, rotation_deviation)
    print(f"Imported  {source} is {what}\nWritten   {out}\nNext      zeroshop {out}")
    return 0


@zeroshop.command("print-board")
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--board", default="a4", show_default=True, help="Size of the paper: a4 or a3.")
def print_board(out: Path, board: str) -> int:
    """Write a printable board, which gives the size of what stands beside it, as a PDF."""
    from zeroshop_steps.runtime.cli import stage_main

    return stage_main("zeroshop_steps.height", ["--method", "print_board", "--board", board, "--out", str(out)])


@zeroshop.command()
def doctor() -> int:
    """Say which networks the card can hold, by its free memory, and what is missing."""
    from zeroshop_steps.app.doctor import examine

    return examine()


@zeroshop.group()
def workflow() -> None:
    """Many objects, tables and clusters, by Snakemake."""


@workflow.command()
@click.argument("folder", type=click.Path(path_type=Path))
def init(folder: Path) -> int:
    """Lay out a project: Snakefile, config.yaml and objects.tsv."""
    from zeroshop_steps.app.project_folders import init_project

    for path in init_project(folder):
        print(f"Written   {path}")
    print("Next      name your objects in objects.tsv; then, in this folder: snakemake --cores 2 results/photos/OBJECT/2dgs.ply")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    Args:
        argv: the command line without the program's name; the process's own by default.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        status = zeroshop.main(words, prog_name="zeroshop", standalone_mode=False, max_content_width=WIDTH)
        return int(status or 0)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except StepError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except (OSError, MemoryError) as error:
        print(f"error: {explain_machine_fault(error) or error}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, click.Abort):
        print("\ninterrupted; the same command goes on where it stopped", file=sys.stderr)
        return 130


def _make_report(folder: Path, cores: int, opens: bool) -> bool:
    """Make the report of all objects so far, and perhaps open it."""
    from zeroshop_steps.app.captures_table import TABLE
    from zeroshop_steps.app.workflow import run_workflow

    index, log = folder / "results/photos/report/index.html", folder / "results/photos/report/logs/zeroshop.log"
    if not run_workflow("results/photos/report/index.html", folder, folder / TABLE, cores, log):
        print(f"The report could not be made; see {log}", file=sys.stderr)
        return False
    print(f"Report    {index}")
    if opens:
        webbrowser.open(index.as_uri())
    return True
