"""Several things on one table, as the HSR's camera sees them (4.4.3): clear of one another, and overlapping in the image.

Two scenes are clear and six overlap, each with up to eight objects, as in the thesis. Nothing is grasped in them. Writes a test set in
BOP's layout, one image a scene; scenes 1 and 2 are the clear ones.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.depth_render import DepthRenderer
from zeroshop_steps.bop.models import list_objects, read_models
from zeroshop_steps.bop.scene import write_scene
from zeroshop_steps.runtime.files import atomic_directory
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.simulate.camera import photograph
from zeroshop_steps.synthetic.clutter import GAP_MM, make_body, place_bodies
from zeroshop_steps.synthetic.make_test_scenes import write_frame
from zeroshop_steps.synthetic.shading import use_threads

CLEAR_SCENES, OVERLAPPING_SCENES = 2, 6
MOST_OBJECTS = 8
CLEAR_GAP_MM = 60.0  # between convex hulls: seen from 45 degrees, low things do not hide what is so far behind them


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--models", type=Path, required=True, help="folder of true, textured models with models_info.json")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default: all)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the scenes to write")


def run(args: argparse.Namespace) -> None:
    """Write the scenes."""
    use_threads(args.threads)
    models = read_models(args.models, list_objects(args.models))
    bodies = {number: make_body(model.mesh.vertices) for number, model in models.items()}
    renderers = {number: DepthRenderer(model.mesh) for number, model in models.items()}
    with atomic_directory(args.out) as folder:
        for scene_id in track(range(1, CLEAR_SCENES + OVERLAPPING_SCENES + 1), "tables", CLEAR_SCENES + OVERLAPPING_SCENES):
            rng = np.random.default_rng([args.seed, scene_id])
            chosen = sorted(rng.permutation(list(models))[:MOST_OBJECTS].tolist())
            gap_mm = CLEAR_GAP_MM if is_clear(scene_id) else GAP_MM
            poses = dict(enumerate(place_bodies([bodies[number] for number in chosen], rng, gap_mm)))
            picture = photograph([models[number].mesh for number in chosen], list(poses.values()), [args.seed, scene_id, 0])
            scene = folder / f"{scene_id:06d}"
            write_scene(scene, [write_frame(scene, scene_id, 0, picture, chosen, poses, renderers)])
    print(f"{args.out}: {CLEAR_SCENES} clear and {OVERLAPPING_SCENES} overlapping scenes", file=sys.stderr)


def is_clear(scene_id: int) -> bool:
    """Whether the things of a scene are clear of one another."""
    return scene_id <= CLEAR_SCENES
