"""Rendered captures: made once from a model, with the scene that a registration by the true cameras gives."""

from pathlib import Path

from casual_captures.capture import render_casual_capture
from casual_captures.home_objects import list_home_objects, write_home_object
from zeroshop_steps.register import truth
from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.registration import write_registration
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.synthetic.bop_models import copy_model
from zeroshop_steps.synthetic.demo_objects import list_demo_objects, write_demo_object

SEED = 0
ENOUGH_FEATURES = 400  # of a photo of 720 px; more would be sought at twice its resolution, in four times the time
SCENE = "video"  # the whole of each photo is registered


def write_model(source: str, data: Path, out: Path) -> None:
    """Write the model folder `out` of a source: `home/NAME` or `demo/NAME`, made by code, or `FOLDER/obj_NUMBER` below `data`.

    Raises:
        StepError: there is no such model.
    """
    kind, _, name = source.rpartition("/")
    if kind == "demo":
        write_demo_object(name, out)
    elif kind == "home":
        write_home_object(name, out)
    elif (data / kind).is_dir():
        copy_model(data / kind, kind.split("/")[0], name, out)
    else:
        made = f"demo/ and one of {', '.join(list_demo_objects())}, or home/ and one of {', '.join(list_home_objects())}"
        raise StepError(f"{source}: no such model; give {made}, or FOLDER/obj_NUMBER, where FOLDER lies below {data}")


def render(source: str, difficulty: int, data: Path, folder: Path, threads: int, with_scene: bool) -> None:
    """Write model/, capture/ and, where it is wanted, scene/ of a rendered capture into `folder`, each unless it is there."""
    model, capture, scene = folder / "model", folder / "capture", folder / "scene"
    if not model.is_dir():
        write_model(source, data, model)
    if not capture.is_dir():
        render_casual_capture(model / "model.ply", difficulty, SEED, capture)
    if with_scene and not scene.is_dir():
        image_set, options = read_image_set(capture), SiftOptions(threads=threads, enough_features=ENOUGH_FEATURES)
        write_registration(scene, lambda out: truth.register(image_set, capture / "truth", SCENE, out, options), estimated=False)
