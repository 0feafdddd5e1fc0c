"""Make a virtual BOP test set: cluttered tables of a dataset's models, as RGB-D images with everything known about them.

Five to eight objects a scene lie or stand close together among distractors, under lights that change from scene to scene. How
they come to rest there is up to the renderer.
Written are the scenes (rgb, depth with a sensor's noise and holes, mask, mask_visib and BOP's three JSON files), the targets
(every object of which at least a tenth is visible) and camera.json.
"""

import argparse
import importlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np

from zeroshop_steps.bop.annotate import annotate
from zeroshop_steps.bop.formats.bop_scenes import HALF_PX, Frame, Instance, write_scene
from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.bop.formats.targets import LEAST_VISIBLE_SHARE, Target, write_targets
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.imaging.images import DEPTH_STEP_MM, write_depth_mm, write_image, write_mask
from zeroshop_steps.geometry.meshes.surface_parts import with_texture
from zeroshop_steps.methods import RENDERERS
from zeroshop_steps.runtime.files import atomic_directory, write_json
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.synthetic.rendering.shading import use_threads
from zeroshop_steps.synthetic.scenes.clutter import make_body
from zeroshop_steps.synthetic.scenes.distractors import make_distractor
from zeroshop_steps.synthetic.scenes.table_scene import RgbdImage, TableScene

OBJECTS = (5, 8)
DISTRACTORS = (1, 3)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--models", type=Path, required=True, help="folder of true, textured models with models_info.json")
    parser.add_argument("--scenes", type=int, default=6, help="tables (default: %(default)s)")
    parser.add_argument("--images", type=int, default=5, help="images of each (default: %(default)s)")
    parser.add_argument("--width-px", type=int, default=640, help="(default: %(default)s)")
    parser.add_argument("--height-px", type=int, default=480, help="(default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default: all)")
    parser.add_argument("--renderer", choices=list(RENDERERS), default=next(iter(RENDERERS)), help="(default: %(default)s)")
    for name in RENDERERS:
        load_renderer(name).add_renderer_arguments(parser)
    parser.add_argument("--targets", type=Path, required=True, help="test_targets_bop19.json to write")
    parser.add_argument("--camera", type=Path, required=True, help="camera.json to write")
    parser.add_argument("--out", type=Path, required=True, help="folder of the scenes to write, BOP's test/")


def run(args: argparse.Namespace) -> None:
    """Write one test set."""
    use_threads(args.threads)
    models = read_models(args.models, list_objects(args.models))
    bodies = {number: make_body(model.mesh.vertices) for number, model in models.items()}
    renderers = {number: DepthRenderer(model.mesh) for number, model in models.items()}
    backend = load_renderer(args.renderer).make_table_backend(args)
    targets: list[Target] = []
    with atomic_directory(args.out) as out:
        for scene_id in track(range(1, args.scenes + 1), "tables", args.scenes):
            rng = np.random.default_rng([args.seed, scene_id])
            chosen = choose_objects(list(models), scene_id, args.seed)
            extras = [make_distractor(rng) for _ in range(rng.integers(DISTRACTORS[0], DISTRACTORS[1] + 1))]
            things = [with_texture(models[number].mesh) for number in chosen] + extras
            shapes = [bodies[number] for number in chosen] + [make_body(extra.vertices) for extra in extras]
            order = rng.permutation(len(things))
            world_from_models = backend.settle(scene_id, [shapes[i] for i in order], rng)
            scene = TableScene([things[i] for i in order], world_from_models, rng, plain=scene_id % 2 == 1)
            poses = {int(i): pose for i, pose in zip(order, world_from_models, strict=True)}
            folder, frames = out / f"{scene_id:06d}", []
            cameras = sample_cameras(scene, args, rng)
            for image, (camera, linear) in enumerate(backend.render(scene_id, scene, cameras)):
                picture = scene.photograph(camera, linear, rng)
                frame = write_frame(folder, scene_id, image, picture, chosen, poses, renderers)
                frames.append(frame)
                targets += [
                    Target(scene_id, image, instance.object_id, 1)
                    for instance in frame.instances
                    if (instance.visible_share or 0.0) >= LEAST_VISIBLE_SHARE
                ]
            write_scene(folder, frames)
    backend.clear()
    write_targets(args.targets, sorted(targets, key=lambda target: (target.scene_id, target.im_id, target.obj_id)))
    write_json(args.camera, make_camera_record(frames[0].intrinsics, args.width_px, args.height_px))
    print(f"{args.out}: {args.scenes} scenes, {args.scenes * args.images} images, {len(targets)} targets")


def load_renderer(name: str) -> ModuleType:
    """The module of a renderer, which has `add_renderer_arguments(parser)` and `make_table_backend(args)`."""
    return importlib.import_module(f"zeroshop_steps.{RENDERERS[name].step}")


def sample_cameras(scene: TableScene, args: argparse.Namespace, rng: np.random.Generator) -> Iterator[Camera]:
    """The cameras of a table, each drawn when it is due."""
    return (scene.sample_camera(args.width_px, args.height_px, f"{image:06d}.png", rng) for image in range(args.images))


def choose_objects(numbers: list[int], scene_id: int, seed: int) -> list[int]:
    """Five to eight objects of a scene, each at most once; from scene to scene all take turns."""
    rng = np.random.default_rng([seed, 0])
    queue: list[int] = []
    most = min(OBJECTS[1], len(numbers))
    for _ in range(scene_id):
        count = int(rng.integers(min(OBJECTS[0], most), most + 1))
        while len(queue) < count:
            queue += [number for number in rng.permutation(numbers).tolist() if number not in queue]
        chosen, queue = queue[:count], queue[count:]
    return sorted(chosen)


def write_frame(
    folder: Path,
    scene_id: int,
    image: int,
    picture: RgbdImage,
    chosen: list[int],
    poses: dict[int, np.ndarray],
    renderers: dict[int, DepthRenderer],
) -> Frame:
    """Write one image with its depth and masks; objects that are not in the image at all are left out."""
    name = f"{image:06d}"
    write_image(folder / "rgb" / f"{name}.png", picture.image)
    write_depth_mm(folder / "depth" / f"{name}.png", picture.measured_mm)
    intrinsics = picture.camera.intrinsics - HALF_PX
    instances: list[Instance] = []
    for index, number in enumerate(chosen):
        camera_from_model = picture.camera.camera_from_world @ poses[index]
        found = annotate(renderers[number], camera_from_model, intrinsics, picture.exact_mm, picture.measured_mm)
        if not found.silhouette.any():
            continue
        write_mask(folder / "mask" / f"{name}_{len(instances):06d}.png", found.silhouette)
        write_mask(folder / "mask_visib" / f"{name}_{len(instances):06d}.png", found.visible)
        instances.append(Instance(number, camera_from_model, found.info["visib_fract"], found.info))
    return Frame(scene_id, image, intrinsics, DEPTH_STEP_MM, picture.camera.camera_from_world, tuple(instances), folder)


def make_camera_record(intrinsics: np.ndarray, width_px: int, height_px: int) -> dict:
    """The content of camera.json."""
    k = intrinsics
    return {
        "cx": k[0, 2], "cy": k[1, 2], "depth_scale": DEPTH_STEP_MM, "fx": k[0, 0], "fy": k[1, 1], "height": height_px, "width": width_px,
    }  # fmt: skip
