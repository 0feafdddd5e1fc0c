"""Volume, centre and inertia of the body that a closed surface bounds."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, number_edges
from zeroshop_steps.runtime.errors import StepError

LEAST_THICKNESS = 1e-7  # of the body's size, by volume and area: coordinates of files are rounded by as much
TO_CLOSE = "The underside and all holes are closed by default; finish: {underside: closed, holes: closed} in the config does it"


@dataclass(frozen=True)
class Solid:
    """A body of even density, in the unit of its mesh.

    Attributes:
        volume: enclosed, in the unit cubed.
        centre: (3,) centre of mass, in the mesh's frame.
        inertia: (3, 3) about the centre, along the mesh's axes, for density 1: times mass / volume it is the body's.
    """

    volume: float
    centre: np.ndarray
    inertia: np.ndarray

    def inertia_of(self, mass: float) -> np.ndarray:
        """(3, 3) inertia about the centre of a body of this mass, along the mesh's axes."""
        return self.inertia * (mass / self.volume)


def count_open_edges(mesh: Mesh) -> int:
    """How many edges belong to an odd number of faces; vertices at one position are one, since a texture seam splits them."""
    _, position = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corners = position.reshape(-1)[mesh.faces]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, count = np.unique(number_edges(edges), return_counts=True)
    return int((count % 2 == 1).sum())


def measure_solid(mesh: Mesh, name: str) -> Solid:
    """The body inside a closed mesh, by exact integrals over its tetrahedra (as trimesh computes them).

    Args:
        mesh: closed, faces counter-clockwise seen from outside.
        name: of its file, for messages.

    Raises:
        StepError: the mesh has open edges, no thickness, or is turned inside out.
    """
    import trimesh

    opened = count_open_edges(mesh)
    if opened:
        raise StepError(f"{name} is open ({opened} edges have one face only), so it has no volume and no inertia. {TO_CLOSE}")
    corners = mesh.vertices[mesh.faces]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = trimesh.triangles.mass_properties(corners, density=1.0)
    volume = float(found.volume)
    area = float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2)
    if abs(volume) <= LEAST_THICKNESS * area**1.5:
        raise StepError(f"{name} has no thickness: it encloses nothing, so it has no inertia; make it as thick as the thing is")
    if volume <= 0:
        raise StepError(f"{name} is inside out: its volume is {volume:.4g}; turn its faces, counter-clockwise seen from outside")
    return Solid(volume, np.asarray(found.center_mass, float), np.asarray(found.inertia, float))
