"""One object, from its photos or films to its mesh and what is made of it: what the command line and the Python API share."""

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from zeroshop_steps.app.captures_table import TABLE, Capture, add_capture, make_name, read_captures
from zeroshop_steps.app.importing import brings_poses, find_source
from zeroshop_steps.app.project_folders import provide_weights
from zeroshop_steps.app.summary import describe_advice, describe_mesh, describe_unseen, describe_warnings, find_reason, name_photos
from zeroshop_steps.app.workflow import count_more_frames, read_chosen_cell, run_workflow, settings_of_inputs
from zeroshop_steps.geometry.meshes.triangle_meshes import OBJECT_SIZES_M
from zeroshop_steps.methods import SURFACES
from zeroshop_steps.plan.captures import JOINED_PHOTOS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

MOST_PASSES = 3
PICTURES = (8, 1000)
METHODS = tuple(SURFACES)
EXPORTS = {
    "urdf": "{mesh}.urdf", "mjcf": "{mesh}.mjcf.xml", "usd": "{mesh}.usda", "usdz": "{mesh}.usdz", "body": "{mesh}.body",
    "foundationpose": "{mesh}.foundationpose", "nerfstudio": "{mesh}.nerfstudio", "colmap": "{mesh}.colmap",
    "bop": "{mesh}.bop",
}  # fmt: skip
"""What a mesh is exported as, and the target, by the path of the mesh without its suffix."""


@dataclass(frozen=True)
class Request:
    """What a user asks for.

    Attributes:
        sources: folders of photos, or films; for each after the first, the object was turned over. The first may also be a capture with
            cameras, in the common form or one that an adapter knows.
        height_m: of the standing object; None where it is unknown.
        name: of the results; that of the first source if empty.
        masks: folder of masks; None for those that are transparent in the photos or lie among them, else they are found.
        board: whether a printed board shows the scale.
        board_photos: folder of photos of the empty scene with it; None where it is beside the object.
        network: name or file of the network that finds the object; None for the usual one.
        count: frames of a film, or photos at most; None for the usual number.
        method: of the surface.
        cores: that may be used.
        into: folder that gets results/.
    """

    sources: Sequence[Path]
    height_m: float | None = None
    name: str = ""
    masks: Path | None = None
    board: bool = False
    board_photos: Path | None = None
    network: str | None = None
    count: int | None = None
    method: str = METHODS[0]
    cores: int = field(default_factory=lambda: os.cpu_count() or 2)
    into: Path = Path()

    def check(self) -> None:
        """Raise StepError for what cannot be done."""
        if not 1 <= len(self.sources) <= MOST_PASSES or len({require_source(path) for path in self.sources}) < len(self.sources):
            raise StepError(f"{len(self.sources)} captures are given; expected up to {MOST_PASSES} different ones of one object")
        if self.masks and len(self.sources) > 1:
            raise StepError("--masks goes with one capture only; leave it out, masks of several passes are found")
        if self.height_m is not None and not OBJECT_SIZES_M[0] <= self.height_m <= OBJECT_SIZES_M[1]:
            raise StepError(
                f"--height is {self.height_m:g}; it is in metres, {OBJECT_SIZES_M[0]:g} to {OBJECT_SIZES_M[1]:g}: write 0.19 for 19 cm"
            )
        if self.count is not None and not PICTURES[0] <= self.count <= PICTURES[1]:
            raise StepError(f"--count is {self.count}; expected {PICTURES[0]} to {PICTURES[1]} frames or photos")
        if self.cores < 1:
            raise StepError(f"--cores is {self.cores}; at least 1 is needed")
        for folder, option in ((self.masks, "--masks"), (self.board_photos, "--board")):
            if folder is not None and not folder.is_dir():
                raise StepError(f"{option} names {folder}, which is no folder")

    def capture(self) -> Capture:
        """The row of the table of objects."""
        paths = [require_source(path) for path in self.sources]
        name = make_name(Path(self.name)) if self.name else make_name(paths[0])
        # No object has a name with a point, so that of a later pass is free.
        names = [name, *(f"{name}.{number}" for number in range(2, len(paths) + 1))]
        sources = [find_source(path, self.into.resolve(), own) for path, own in zip(paths, names, strict=True)]
        with_poses = [source.poses for source in sources]
        if any(with_poses) and not all(with_poses):
            raise StepError(
                f"{paths[with_poses.index(True)]} brings the poses of its cameras, and {paths[with_poses.index(False)]} does not; give"
                " captures that all bring them, or the photos alone"
            )
        own_height = "" if self.height_m is not None else sources[0].height_method
        ends = ["", *(f"_{number}" for number in range(2, len(paths) + 1))]
        parts = {
            f"{column}{end}": value
            for end, source in zip(ends, sources, strict=True)
            for column, value in {
                "images": str(source.images),
                "masks": source.masks or _find_own_masks(source.images),
                "depth": source.depth,
                "cameras": source.cameras,
            }.items()
        }
        if self.masks:
            parts["masks"] = str(self.masks.resolve())
        return Capture(
            object=name,
            height_m=f"{self.height_m:g}" if self.height_m is not None else "",
            height_method="marker" if self.board else "known" if self.height_m is not None else own_height,
            marker_images=str(self.board_photos.resolve()) if self.board_photos else "",
            picture_count=str(self.count or ""),
            **parts,
        )


@dataclass(frozen=True)
class Outcome:
    """What came of a request.

    Attributes:
        done: whether there is a mesh.
        mesh: where it is, or would be.
        cell: the folder of what was made on the way.
        log: all that was said.
        folder, table: where the workflow ran, and its table of objects.
        cores: that may be used.
    """

    done: bool
    mesh: Path
    cell: Path
    log: Path
    folder: Path
    table: Path
    cores: int

    @property
    def cameras(self) -> Path:
        """The folder of the registered cameras."""
        return self.cell.parent / "cameras"

    @property
    def facts(self) -> dict[str, Any]:
        """What the JSON beside the mesh says."""
        return read_json(self.mesh.with_suffix(".json"))

    def describe(self, start_s: float) -> list[str]:
        """What people are told, of a run that began at `start_s`, in seconds since the epoch."""
        results = self.mesh.parent
        if self.done:
            lines = [*describe_mesh(self.mesh), *describe_unseen(self.mesh)]
        else:
            lines = [f"Failed    {line}" for line in find_reason(self.log)]
        lines += describe_advice(self.cell, self.cameras) + describe_warnings(results, start_s)
        lines = [name_photos(line, results) for line in lines]
        return [*lines, f"Time      {(time.time() - start_s) / 60:.1f} min; full log: {self.log}"]

    def make(self, target: Path) -> Path:
        """Make a file or folder of the workflow beside the mesh.

        Raises:
            StepError: it could not be made; says why.
        """
        log = self.mesh.parent / "logs" / f"zeroshop_{target.name}.log"
        if not run_workflow(str(target.relative_to(self.folder)), self.folder, self.table, self.cores, log):
            raise StepError(f"{target} could not be made: {'; '.join(find_reason(log))}; full log: {log}")
        return target

    def export(self, kind: str) -> Path:
        """Make what robots and simulators read: one of `EXPORTS`.

        Raises:
            StepError: there is no such kind, or it could not be made.
        """
        if kind not in EXPORTS:
            raise StepError(f"there is no export {kind}; there are {', '.join(EXPORTS)}")
        return self.make(Path(EXPORTS[kind].format(mesh=self.mesh.with_suffix(""))))


def make_mesh(request: Request) -> Outcome:
    """Make a mesh. Where frames of a film give no cameras, more are taken once.

    Raises:
        StepError: what is asked for cannot be done.
    """
    settings, folder, capture = prepare(request)
    results = folder / "results/photos" / capture.object
    run = partial(run_for, request, settings, capture, f"{request.method}.ply")
    done = run()
    scene, registration = read_chosen_cell(settings, brings_poses(capture.cameras))
    if not (done or capture.picture_count or capture.images_2) and (count := count_more_frames(results / scene / registration)):
        print(f"The frames have no sure cameras; trying again with {count} of the film", file=sys.stderr)
        add_capture(folder, replace(capture, picture_count=str(count)))
        done = run()
    return describe_run(request, settings, capture, done)


def prepare(request: Request) -> tuple[dict[str, Any], Path, Capture]:
    """Put a request into the table of its folder: the settings of the config, the absolute folder, and the row.

    Raises:
        StepError: what is asked for cannot be done.
    """
    request.check()
    provide_weights()
    settings = settings_of_inputs(request.network)
    folder, capture = request.into.resolve(), request.capture()
    folder.mkdir(parents=True, exist_ok=True)
    capture = add_capture(folder, capture)
    print(f"{', '.join(map(str, request.sources))} -> {folder / 'results/photos' / capture.object}", file=sys.stderr)
    return settings, folder, capture


def run_for(request: Request, settings: dict[str, Any], capture: Capture, target: str) -> bool:
    """Make a file or folder below the results of an object; whether that went well."""
    folder, results = request.into.resolve(), Path("results/photos") / capture.object
    return run_workflow(str(results / target), folder, folder / TABLE, request.cores, folder / results / "logs/zeroshop.log", settings)


def describe_run(request: Request, settings: dict[str, Any], capture: Capture, done: bool) -> Outcome:
    """What came of the run for an object."""
    scene, registration = read_chosen_cell(settings, brings_poses(capture.cameras))
    folder = request.into.resolve()
    results = folder / "results/photos" / capture.object
    cell = results / (JOINED_PHOTOS if capture.images_2 else scene) / registration / request.method
    return Outcome(done, results / f"{request.method}.ply", cell, results / "logs/zeroshop.log", folder, folder / TABLE, request.cores)


def find_outcome(name: str, method: str = METHODS[0], into: Path = Path(), cores: int = os.cpu_count() or 2) -> Outcome:
    """What was made before of an object.

    Raises:
        StepError: no mesh of this name is there.
    """
    folder = into.resolve()
    results = folder / "results/photos" / name
    mesh = results / f"{method}.ply"
    if not mesh.is_file():
        made = sorted(path.parent.name for path in folder.glob(f"results/photos/*/{method}.ply"))
        raise StepError(f"{mesh} does not exist; make it with `zeroshop PHOTOS`. Meshes made here: {', '.join(made) or 'none'}")
    captures = read_captures(folder)
    scene, registration = read_chosen_cell({}, name in captures and brings_poses(captures[name].cameras))
    scene = JOINED_PHOTOS if (results / JOINED_PHOTOS).is_dir() else scene
    log = results / "logs/zeroshop.log"
    return Outcome(True, mesh, results / scene / registration / method, log, folder, folder / TABLE, cores)


def require_source(path: Path) -> Path:
    """The absolute path of a capture that exists."""
    if not path.exists():
        raise StepError(f"{path} does not exist; name a folder of photos or a video")
    return path.resolve()


def _find_own_masks(photos: Path) -> str:
    """The folder of the photos as that of their masks, where their background was removed, or masks lie among them."""
    from zeroshop_steps.capture.mask_names import split_masks
    from zeroshop_steps.capture.photo_files import is_cut_out, list_photos

    if not photos.is_dir():
        return ""
    if masks := split_masks(list_photos(photos)[0])[1]:
        print(f"Masks lie among the photos and are taken, such as {masks[0].name}", file=sys.stderr)
    elif is_cut_out(photos):
        print("The background of the photos is transparent: what is left of them is taken as masks", file=sys.stderr)
    else:
        return ""
    return str(photos)
