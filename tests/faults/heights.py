"""Faults of what the height is measured by: depth images, photos of the board in the empty scene, and the records beside them."""

import atexit
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from helpers.carton_scene import Carton, photographed_carton
from helpers.faults import Fault, step
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.imaging.images import list_images, write_image
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.files import write_json

FIRST = "000000.png"


@cache
def make_once() -> tuple[Carton, Path]:
    """A small carton, and a folder with the depth images of its photos."""
    folder = Path(mkdtemp(prefix="faults."))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    carton = photographed_carton(folder / "carton")
    renderer = MeshRenderer(carton.mesh)
    for view in read_views(carton.cameras)[0]:
        depth = renderer.cast_rays(view.camera).depth
        write_image(folder / "depth" / view.camera.name, np.where(depth > 0, depth, 900.0).astype(np.uint16))
    return carton, folder / "depth"


def measure(method: str, folder: Path, **options: object) -> int:
    """Measure the carton's height."""
    carton, _ = make_once()
    return step(
        "height", method, mesh=carton.model, cameras=carton.cameras, capture=folder / "capture", out=folder / "height.json", **options
    )


def by_depth(spoil: Callable[[Path], object], capture: object = None) -> Callable[[Path], int]:
    """Measure by depth images that `spoil` has changed, with this record of the capture."""

    def run(folder: Path) -> int:
        depth = shutil.copytree(make_once()[1], folder / "depth")
        write_json(folder / "capture/capture.json", {} if capture is None else capture)
        spoil(depth)
        return measure("depth_camera", folder, depth=depth)

    return run


def by_board(spoil: Callable[[Path], object]) -> Callable[[Path], int]:
    """Measure by photos of the empty scene that `spoil` has changed."""

    def run(folder: Path) -> int:
        (folder / "scene").mkdir()
        for photo in list_images(make_once()[0].cameras / "images")[:4]:
            shutil.copy(photo, folder / "scene")
        write_json(folder / "capture/capture.json", {})
        spoil(folder / "scene")
        return measure("marker", folder, marker_images=folder / "scene")

    return run


def replace_with(make: Callable[[Path], object]) -> Callable[[Path], object]:
    """Something else in place of the first image."""

    def spoil(folder: Path) -> None:
        (folder / FIRST).unlink()
        make(folder / FIRST)

    return spoil


def cut(folder: Path) -> None:
    """Half of the first image."""
    path = folder / FIRST
    path.write_bytes(path.read_bytes()[:300])


def nothing(folder: Path) -> None:
    """No change."""


NAMES = r"capture\.json: source_names must list the user's photos"
FAULTS = [
    Fault("half a depth image", by_depth(cut), (r"depth/000000\.png cannot be read", "export it again")),
    Fault("a folder among depth images", by_depth(replace_with(Path.mkdir)), (r"depth/000000\.png is a folder", "remove it")),
    Fault("a pipe among depth images", by_depth(replace_with(os.mkfifo)), (r"depth/000000\.png is no file", "remove it")),
    Fault(
        "a loop among depth images",
        by_depth(replace_with(lambda path: path.symlink_to(path))),
        (r"depth/000000\.png is a link that leads nowhere", "remove it"),
    ),
    *(
        Fault(f"source names that are {name}", by_depth(nothing, {"source_names": value}), (NAMES, "run capture again"))
        for name, value in (("too few", ["a.jpg"]), ("one text", "a.jpg"), ("numbers", list(range(10))))
    ),
    Fault("a record that is a list", by_depth(nothing, []), (r"capture\.json holds no JSON object, but a list", "run its step again")),
    Fault("half a photo of the empty scene", by_board(cut), (r"scene/000000\.png cannot be read", "export it again")),
    Fault("an empty scene without texture", by_board(nothing), ("share no point of the ground", "something with texture")),
    Fault(
        "an empty scene without photos", by_board(lambda folder: [path.unlink() for path in folder.iterdir()]), (r"scene holds no images",)
    ),
]
