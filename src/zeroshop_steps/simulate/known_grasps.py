"""What a robot's hand knows of a mesh: its grasps and its surface."""

import sys
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.models import model_path
from zeroshop_steps.finish.closing.underside import close_underside
from zeroshop_steps.geometry.meshes.mass_properties import count_open_edges
from zeroshop_steps.geometry.meshes.metric_mesh import MetricMesh, read_metric_mesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.grasp.antipodal import HOLLOW_TEXT, FoundGrasps, GraspOptions, find_grasps
from zeroshop_steps.grasp.gripper import Gripper
from zeroshop_steps.runtime.errors import StepError, warn


def grasps_of_model(models: Path, object_id: int, gripper: Gripper, options: GraspOptions) -> FoundGrasps:
    """The grasps of one model of a folder; none, with a warning, where there is none.

    An open underside is closed first, as `finish` does it: grasps need a body. What was added is unseen and not grasped.
    """
    path = model_path(models, object_id)
    metric = read_metric_mesh(path)
    if count_open_edges(metric.mesh):
        closed = close_below(metric.mesh)
        metric = MetricMesh(closed, metric.scale, metric.scale_source, metric.relative_deviation)
    try:
        found = find_grasps(metric, gripper, options, str(path))
    except StepError as error:
        warn(f"{path} cannot be grasped: {error}")
        return FoundGrasps([], [], metric.mesh.vertices, options.friction)
    print(f"{path}: {len(found.grasps)} grasps{', ' + HOLLOW_TEXT if found.hollow else ''}", file=sys.stderr)
    return found


def close_below(mesh: Mesh) -> Mesh:
    """A mesh that stands upright, its underside closed; the faces that were added have quality 0, all others 1."""
    vertices, position = np.unique(mesh.vertices, axis=0, return_inverse=True)
    joined = Mesh(vertices, position.reshape(-1)[mesh.faces])
    closed, _ = close_underside(joined, np.array([0.0, 0.0, 1.0]), float(vertices[:, 2].min()))
    quality = np.zeros(len(closed.vertices))
    quality[: len(vertices)] = 1.0
    return Mesh(closed.vertices, closed.faces, quality=quality)
