"""Nearest points and signed distances of a surface that photos measured, and that may be open."""

import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.finish.closing.underside import find_open_borders
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

RIM_SHARE = 0.75
"""Nearer to an open border than this share of the distance up to which signs are asked for, a nearest point has no side."""


class MeasuredSurface:
    """Nearest points and sides of an open mesh with normals."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.scene = ray_caster((mesh.vertices, mesh.faces))
        borders = find_open_borders(mesh.faces)
        self.rims = cKDTree(mesh.vertices[np.concatenate(borders)]) if borders else None

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, 3) nearest points of the surface and (P, 3) its interpolated normals there."""
        answer = self.scene.compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
        faces, uv = answer["primitive_ids"].numpy().astype(np.int64), answer["primitive_uvs"].numpy()
        weights = np.concatenate([1.0 - uv.sum(1, keepdims=True), uv], axis=1)
        normals = np.einsum("pk,pkc->pc", weights, self.mesh.vertex_normals[self.mesh.faces[faces]])
        return answer["points"].numpy().astype(float), normals

    def distance_from_rims(self, points: np.ndarray) -> np.ndarray:
        """(P,) distance of (P, 3) points to the open borders; infinite where there are none."""
        return np.full(len(points), np.inf) if self.rims is None else self.rims.query(points)[0]

    def signed_distance(self, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """(P,) distance, positive outside, and (P,) bool whether it can be trusted: within `reach`, and not at an open border.

        Points beyond `reach` may be given any distance.
        """
        signed, known = np.zeros(len(points)), self.may_reach(points, reach)
        points = points[known]
        nearest, normals = self.nearest(points)
        away = points - nearest
        distance = np.linalg.norm(away, axis=1)
        signed[known] = np.where(np.einsum("pc,pc->p", away, normals) >= 0.0, distance, -distance)
        within = distance < reach
        within[within] = self.distance_from_rims(nearest[within]) > RIM_SHARE * reach
        known[known] = within
        return signed, known

    def may_reach(self, points: np.ndarray, reach: float) -> np.ndarray:
        """(P,) bool: all points within `reach` of the surface, and a few more. A nearest point takes far longer to find.

        They lie in the cells, as wide as `reach`, that a face's box touches once it is that much wider on all sides.
        """
        wider = 1.01 * reach  # more than rounding can take away
        corners = self.mesh.vertices[self.mesh.faces]
        first = corners.min((0, 1)) - wider
        low = np.floor((corners.min(1) - wider - first) / reach).astype(np.int64)
        high = np.floor((corners.max(1) + wider - first) / reach).astype(np.int64) + 1
        # Boxes are counted by their eight corners: sums along the axes fill them.
        count = np.zeros(high.max(0) + 1, np.int64)
        for pick in np.ndindex(2, 2, 2):
            np.add.at(count, tuple(np.where(pick, high, low).T), (-1) ** sum(pick))
        touched = count.cumsum(0).cumsum(1).cumsum(2) > 0
        cell = np.floor((points - first) / reach).astype(np.int64)
        inside = ((cell >= 0) & (cell < touched.shape)).all(1)
        inside[inside] = touched[tuple(cell[inside].T)]
        return inside

    def snapped(self, closed: Mesh, reach: float) -> Mesh:
        """The closed mesh with vertices within `reach` of this surface, away from its open borders, put onto it."""
        nearest, _ = self.nearest(closed.vertices)
        move = np.linalg.norm(nearest - closed.vertices, axis=1) < reach
        move[move] = self.distance_from_rims(nearest[move]) > reach
        return Mesh(np.where(move[:, None], nearest, closed.vertices), closed.faces)
