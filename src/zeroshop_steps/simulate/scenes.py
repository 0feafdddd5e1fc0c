"""Several things on one table, as the HSR's camera sees them (4.4.3): clear of one another, and overlapping in the image.

In the first scenes things are clear of one another, in the others they overlap; each has up to eight objects, as in the thesis.
Everything stands wholly in the image. In a clear scene no silhouette touches another; in an overlapping one each touches another one.
Nothing is grasped in them. Writes a test set in BOP's layout, one image a scene, with layouts.json, which says which scenes are clear.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import HALF_PX, write_scene
from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.simulate.camera import HEIGHT_PX, WIDTH_PX, hsr_camera, photograph
from zeroshop_steps.synthetic.make_test_scenes import write_frame
from zeroshop_steps.synthetic.rendering.shading import use_threads
from zeroshop_steps.synthetic.scenes.clutter import RigidBody, make_body, place_bodies

CLEAR_GAP_MM, CLOSE_GAP_MM = 20.0, 3.0  # between convex hulls, at least: room for a finger, and hardly any
CLEAR_PX = 6  # between silhouettes, at least, where things are to be clear of one another
TRIES = 5  # whole tables that are drawn before it is given up
CLEAR, OVERLAPPING = "clear", "overlapping"
LAYOUTS = "layouts.json"


@dataclass(frozen=True)
class Layout:
    """The things of one table.

    Attributes:
        bodies: their shapes.
        renderers: of the same models, in the same order.
    """

    bodies: Sequence[RigidBody]
    renderers: Sequence[DepthRenderer]

    def draw(self, rng: np.random.Generator, clear: bool) -> list[np.ndarray]:
        """(4, 4) table_from_model of each thing, mm, all wholly in the image.

        Args:
            rng: of the places and of how things lie.
            clear: whether no silhouette touches another; otherwise each touches one.

        Raises:
            StepError: there is no such place for a thing, mostly because all are too large together.
        """
        for attempt in range(TRIES):
            try:
                return self._draw_once(rng, clear)
            except StepError:
                if attempt == TRIES - 1:
                    raise
        raise AssertionError("the last try returns or raises")

    def _draw_once(self, rng: np.random.Generator, clear: bool) -> list[np.ndarray]:
        taken = np.zeros((HEIGHT_PX, WIDTH_PX), bool)
        margin = np.ones((2 * CLEAR_PX + 1,) * 2, np.uint8) if clear else np.ones((3, 3), np.uint8)

        def accept(index: int, table_from_model: np.ndarray) -> bool:
            if not is_inside(transform_points(self.bodies[index].hull, table_from_model)):
                return False
            seen = self._silhouette(index, table_from_model)
            touches = bool((cv2.dilate(seen.astype(np.uint8), margin).astype(bool) & taken).any())
            if taken.any() and touches == clear:
                return False
            taken[seen] = True
            return True

        return place_bodies(self.bodies, rng, CLEAR_GAP_MM if clear else CLOSE_GAP_MM, accept)

    def _silhouette(self, index: int, table_from_model: np.ndarray) -> np.ndarray:
        camera = hsr_camera()
        patch = self.renderers[index].render(camera.camera_from_world @ table_from_model, camera.intrinsics - HALF_PX, WIDTH_PX, HEIGHT_PX)
        return patch.image(WIDTH_PX, HEIGHT_PX) > 0


def is_inside(points_mm: np.ndarray) -> bool:
    """Whether (P, 3) points above the table are all in the image, a pixel from its border at least."""
    camera = hsr_camera()
    seen = transform_points(points_mm, camera.camera_from_world)
    if seen[:, 2].min() <= 0.0:
        return False
    pixels = (seen @ camera.intrinsics.T)[:, :2] / seen[:, 2:]
    return bool((pixels >= 1.0).all() and (pixels <= (WIDTH_PX - 1.0, HEIGHT_PX - 1.0)).all())


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
