"""Several objects in the same photos: a mesh of each, by the same cameras."""

import re
import sys
from collections.abc import Iterator
from dataclasses import replace

from zeroshop_steps.app.captures_table import add_capture
from zeroshop_steps.app.importing import brings_poses
from zeroshop_steps.app.reconstruct_object import Outcome, Request, describe_run, prepare, run_for
from zeroshop_steps.app.workflow import read_chosen_cell
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

ALL = "all"


def make_meshes(request: Request, objects: str) -> Iterator[Outcome]:
    """Register the photos once, list the objects in them, and make the mesh of each that is chosen, named NAME_1, NAME_2 and so on.

    Args:
        request: of the photos.
        objects: "all"; a count, such as "3", of the likeliest; or numbers of the list, such as "1,4" or "4,".

    Yields:
        What came of each; one that failed where there are no cameras or no objects.

    Raises:
        StepError: what is asked for cannot be done.
    """
    if request.height_m is not None or request.masks or len(request.sources) > 1:
        raise StepError(
            "--objects goes with one capture, without --height and --masks; a printed board (--board) or known cameras give the size of all"
        )
    choose_numbers(objects, 100)
    settings, folder, capture = prepare(request)
    scene, registration = read_chosen_cell(settings, brings_poses(capture.cameras))
    listed = f"{scene}/{registration}/objects"
    if not run_for(request, settings, capture, listed):
        yield describe_run(request, settings, capture, False)
        return
    results = folder / "results/photos" / capture.object / listed
    count = len(read_json(results / "objects.json")["objects"])
    numbers = choose_numbers(objects, count)
    print(f"{count} objects, numbered in {results / 'objects.png'}; meshes of {', '.join(map(str, numbers))}", file=sys.stderr)
    for number in numbers:
        own = replace(capture, object=f"{capture.object}_{number}", scene_of=capture.object, number=str(number))
        own = add_capture(folder, own)
        yield describe_run(request, settings, own, run_for(request, settings, own, f"{request.method}.ply"))


def choose_numbers(objects: str, count: int) -> list[int]:
    """The numbers, from 1, that `objects` chooses of so many. Raises StepError where it chooses none, or others."""
    if objects == ALL:
        return list(range(1, count + 1))
    if not re.fullmatch(r"\d+(,\d+)*,?", objects):
        raise StepError(f"--objects is {objects}; expected all, a count such as 3, or numbers such as 1,4 or 4, with a comma")
    numbers = sorted({int(part) for part in objects.split(",") if part}) if "," in objects else list(range(1, min(int(objects), count) + 1))
    if not numbers or not all(1 <= number <= count for number in numbers):
        raise StepError(f"--objects is {objects}; the photos show {count} objects, numbered from 1")
    return numbers
