"""Give rendered captures the layout of a BOP training set, as BlenderProc's BOP writer does: `train_pbr/` of any BOP method.

Every capture becomes one scene, numbered as its object: rgb, exact depth, mask, mask_visib and BOP's three JSON files; camera.json
lies beside the split.
"""

import argparse
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.annotate import annotate
from zeroshop_steps.bop.formats.bop_scenes import HALF_PX, Frame, Instance, write_scene
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model
from zeroshop_steps.geometry.imaging.images import DEPTH_STEP_MM, read_depth_mm, read_image, write_depth_mm, write_image, write_mask
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.synthetic.make_test_scenes import make_camera_record


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--captures", type=Path, nargs="+", required=True, help="capture folders of rendered scenes")
    parser.add_argument("--models", type=Path, nargs="+", required=True, help="model folders of their objects, in the same order")
    parser.add_argument("--camera", type=Path, required=True, help="camera.json to write")
    parser.add_argument("--out", type=Path, required=True, help="folder of the scenes to write, BOP's train_pbr/")


def run(args: argparse.Namespace) -> None:
    """Write one training set."""
    if len(args.captures) != len(args.models):
        raise StepError(f"{len(args.captures)} captures and {len(args.models)} models were given; give each capture its model")
    numbers: dict[int, Path] = {}
    with atomic_directory(args.out) as out:
        pairs = list(zip(args.captures, args.models, strict=True))
        for capture, model in track(pairs, "training scenes", len(pairs)):
            number = int(read_json(model / "model_info.json")["obj_id"])
            if number in numbers:
                raise StepError(f"{capture} and {numbers[number]} show the same object, {number}; a training set takes one capture of each")
            numbers[number] = capture
            camera = write_training_scene(out / f"{number:06d}", number, capture, model)
    write_json(args.camera, make_camera_record(camera.intrinsics - HALF_PX, camera.width_px, camera.height_px))


def write_training_scene(folder: Path, number: int, capture: Path, model: Path) -> Camera:
    """Write one capture as the scene `number`; returns the last of its cameras.

    Raises:
        StepError: the capture is not a rendered one with its truth.
    """
    if not (capture / "truth").is_dir() or not (capture / "depth").is_dir():
        raise StepError(f"{capture} has no truth/ and depth/; a training set is made of rendered captures")
    renderer = DepthRenderer(read_ply(model / "model.ply"))
    frames = []
    for image, camera in enumerate(read_sparse_model(capture / "truth").cameras):
        name = f"{image:06d}"
        depth_mm = read_depth_mm(capture / "depth" / camera.name)
        write_image(folder / "rgb" / f"{name}.png", read_image(capture / "images" / camera.name))
        write_depth_mm(folder / "depth" / f"{name}.png", depth_mm)
        # Nothing stands before the object.
        found = annotate(renderer, camera.camera_from_world, camera.intrinsics - HALF_PX, np.zeros_like(depth_mm), depth_mm)
        write_mask(folder / "mask" / f"{name}_000000.png", found.silhouette)
        write_mask(folder / "mask_visib" / f"{name}_000000.png", found.visible)
        instance = Instance(number, camera.camera_from_world, found.info["visib_fract"], found.info)
        frames.append(Frame(number, image, camera.intrinsics - HALF_PX, DEPTH_STEP_MM, camera.camera_from_world, (instance,), folder))
    write_scene(folder, frames)
    return camera
