"""Render templates: colour, depth and mask of each model of a folder from 42 or 642 directions.

The directions are the corners of an icosahedron whose faces were divided in four once (42) or three times (642). The model is in the
centre of every view, as large as fits in any rotation. Writes one file per model, obj_000001.npz.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from zeroshop_steps.bop.formats.models import ObjectModel, list_objects, read_models
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import DISTANCE_RADII, FILLED, look_at, make_intrinsics
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory
from zeroshop_steps.runtime.progress import track

CACHED = Cached(inputs=("models",))
SUBDIVISIONS = {42: 1, 642: 3}  # of an icosahedron, by the number of views at its corners
TURN_RAD, TURN_AXIS = 0.1, (1.0, 0.3, 0.2)  # of all directions together, so that no camera looks straight down, where up is undefined


@dataclass(frozen=True)
class Templates:
    """The views of one model, N of them.

    Attributes:
        colors: (N, side, side, 3) uint8 unlit texture; the background is black.
        depths_mm: (N, side, side) float32 along the optical axis; the background is 0.
        camera_from_model: (N, 4, 4) mm.
        intrinsics: (3, 3) of all views; the centre of pixel (0, 0) is at (0.5, 0.5).
    """

    colors: np.ndarray
    depths_mm: np.ndarray
    camera_from_model: np.ndarray
    intrinsics: np.ndarray

    @property
    def masks(self) -> np.ndarray:
        """(N, side, side) bool."""
        return self.depths_mm > 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--models", type=Path, required=True, help="folder of models in BOP's layout")
    parser.add_argument("--views", type=int, choices=SUBDIVISIONS, default=42, help="number of directions (default: %(default)s)")
    parser.add_argument("--side-px", type=int, default=224, help="side of the square views (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Render the views of all models of a folder."""
    models = read_models(args.models, list_objects(args.models))
    with atomic_directory(args.out) as folder:
        for model in track(models.values(), "templates", len(models)):
            save_templates(folder, model, args.views, args.side_px)


def save_templates(folder: Path, model: ObjectModel, views: int, side_px: int) -> None:
    """Render one model from `views` directions, 42 or 642, and write its file, which `read_templates` reads."""
    np.savez(folder / f"obj_{model.object_id:06d}.npz", **vars(render_templates(model, views, side_px)))


def render_templates(model: ObjectModel, views: int, side_px: int) -> Templates:
    """Render one model from `views` directions, 42 or 642."""
    vertices = model.mesh.vertices
    middle = (vertices.min(0) + vertices.max(0)) / 2
    radius_mm = float(np.linalg.norm(vertices - middle, axis=1).max())
    distance_mm = DISTANCE_RADII * radius_mm
    focal_px = FILLED * side_px / 2 * np.sqrt(distance_mm**2 - radius_mm**2) / radius_mm
    intrinsics = make_intrinsics(focal_px, side_px, side_px)
    renderer = MeshRenderer(model.mesh)
    colors, depths, poses = [], [], []
    for direction in make_view_directions(views):
        pose = look_at(middle + distance_mm * direction, middle)
        camera = Camera("", side_px, side_px, intrinsics, pose)
        depth = renderer.find_depth(camera)
        color, _ = renderer.render_masked_color(camera)
        colors.append(np.where((depth > 0)[..., None], color, 0))
        depths.append(depth)
        poses.append(pose)
    return Templates(np.stack(colors), np.stack(depths), np.stack(poses), intrinsics)


def make_view_directions(views: int) -> np.ndarray:
    """(views, 3) unit vectors from the model to its cameras."""
    corners = np.asarray(trimesh.creation.icosphere(SUBDIVISIONS[views], 1.0).vertices)
    turn = trimesh.transformations.rotation_matrix(TURN_RAD, TURN_AXIS)[:3, :3]
    return corners @ turn.T


def read_templates(folder: Path, object_id: int) -> Templates:
    """Read the views of one model. Raises StepError if there are none."""
    path = Path(folder) / f"obj_{object_id:06d}.npz"
    try:
        with np.load(path) as content:
            return Templates(**content)
    except (OSError, ValueError, TypeError) as error:
        raise StepError(f"{path} holds no views of object {object_id} ({error}); make them with --method templates") from None
