"""Several things on one table, as the HSR's camera sees them (4.4.3): clear of one another, and overlapping in the image.

In the first scenes things are clear of one another, in the others they overlap; each has up to eight objects, as in the thesis.
Everything stands wholly in the image. In a clear scene no silhouette touches another; in an overlapping one each touches another one.
Nothing is grasped in them. Writes a test set in BOP's layout, one image a scene, with layouts.json, which says which scenes are clear.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import write_scene
from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.simulate.camera import photograph
from zeroshop_steps.simulate.layout import Layout
from zeroshop_steps.synthetic.make_test_scenes import write_frame
from zeroshop_steps.synthetic.rendering.shading import use_threads
from zeroshop_steps.synthetic.scenes.clutter import make_body

CLEAR, OVERLAPPING = "clear", "overlapping"
LAYOUTS = "layouts.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--models", type=Path, required=True, help="folder of true, textured models with models_info.json")
    parser.add_argument("--clear-scenes", type=int, default=2, help="scenes in which all stand apart (default: %(default)s)")
    parser.add_argument("--overlapping-scenes", type=int, default=6, help="scenes in which things overlap (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default: all)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the scenes to write")


def run(args: argparse.Namespace) -> None:
    """Write the scenes."""
    use_threads(args.threads)
    models = read_models(args.models, list_objects(args.models))
    if len(models) < 2:
        raise StepError(f"{args.models} has {len(models)} models; several things on a table need two or more")
    bodies = {number: make_body(model.mesh.vertices) for number, model in models.items()}
    renderers = {number: DepthRenderer(model.mesh) for number, model in models.items()}
    layouts = [CLEAR] * args.clear_scenes + [OVERLAPPING] * args.overlapping_scenes
    with atomic_directory(args.out) as folder:
        for scene_id, kind in track(enumerate(layouts, 1), "tables", len(layouts)):
            rng = np.random.default_rng([args.seed, scene_id])
            chosen = sorted(rng.permutation(list(models))[:8].tolist())
            layout = Layout([bodies[number] for number in chosen], [renderers[number] for number in chosen])
            poses = dict(enumerate(layout.draw(rng, kind == CLEAR)))
            picture = photograph([models[number].mesh for number in chosen], list(poses.values()), [args.seed, scene_id, 0])
            scene = folder / f"{scene_id:06d}"
            write_scene(scene, [write_frame(scene, scene_id, 0, picture, chosen, poses, renderers)])
        write_json(folder / LAYOUTS, {str(scene_id): kind for scene_id, kind in enumerate(layouts, 1)})
    print(f"{args.out}: {args.clear_scenes} clear and {args.overlapping_scenes} overlapping scenes", file=sys.stderr)


def read_layouts(folder: Path) -> dict[int, str]:
    """Of each scene of a folder that this step wrote, by number, `clear` or `overlapping`. Raises StepError where it is missing."""
    return {int(scene_id): kind for scene_id, kind in read_json(folder / LAYOUTS).items()}
