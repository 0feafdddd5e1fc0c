"""Meshes in MeshLab: to and from its sets, and the smoothing that keeps a shape's size."""

from typing import TYPE_CHECKING

import numpy as np

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

if TYPE_CHECKING:
    import pymeshlab

VOXEL_STEPS = 5  # of Taubin's smoothing, which take the steps of voxels away from a surface
TAUBIN_LAMBDA, TAUBIN_MU = 0.5, -0.53  # a step that shrinks, then one that grows a little more


def to_meshlab(mesh: Mesh) -> "pymeshlab.MeshSet":
    """A set with the shape of a mesh."""
    import pymeshlab

    worker = pymeshlab.MeshSet(verbose=False)
    worker.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces.astype(np.int32)))
    return worker


def from_meshlab(worker: "pymeshlab.MeshSet") -> Mesh:
    """The shape of a set's current mesh."""
    found = worker.current_mesh()
    return Mesh(np.array(found.vertex_matrix()), np.array(found.face_matrix(), np.int64))


def smooth_taubin(worker: "pymeshlab.MeshSet", steps: int) -> None:
    """Smooth by pairs of Taubin's steps (SIGGRAPH 1995), which do not shrink; along open borders, neighbours there alone count."""
    if steps > 0:
        worker.apply_coord_taubin_smoothing(lambda_=TAUBIN_LAMBDA, mu=TAUBIN_MU, stepsmoothnum=steps)
