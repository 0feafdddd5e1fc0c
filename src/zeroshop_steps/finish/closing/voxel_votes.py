"""Voxels around a mesh, and what each photo says of them: empty outside its mask or in front of surface, solid just behind it."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numba
import numpy as np

from zeroshop_steps.finish.clean import RENDER_PX
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.transforms import shrink_camera
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.visibility import MIXED_PX
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer

ROOM = 1.12
"""Side of the block of voxels, in the longest side of the mesh's box."""
FRONT_VOXELS, BEHIND_VOXELS = 1.5, (0.5, 4.0)
"""A voxel this far in front of measured surface is seen through; between these behind it, solid."""


@dataclass(frozen=True)
class Grid:
    """Cubic voxels: `count` along each edge, the first centre at `first` (3,), `side` apart."""

    first: np.ndarray
    side: float
    count: int

    @staticmethod
    def around(mesh: Mesh, count: int) -> "Grid":
        """A block about the mesh's box, with room."""
        low, high = mesh.vertices.min(0), mesh.vertices.max(0)
        extent = ROOM * float((high - low).max())
        return Grid((low + high) / 2 - extent / 2 + extent / count / 2, extent / count, count)

    def centres(self, index: np.ndarray) -> np.ndarray:
        """(P, 3) centres of the voxels (P, 3)."""
        return self.first + index * self.side


@dataclass(frozen=True)
class Votes:
    """How many views say of each voxel, (R, R, R) uint8: it is framed, outside the mask, in front of surface, just behind it."""

    framed: np.ndarray
    outside: np.ndarray
    empty: np.ndarray
    solid: np.ndarray


def cast_votes(grid: Grid, mesh: Mesh, views: Sequence[View]) -> Votes:
    """Let every view vote, with its mask and the depth of the mesh where it shows its front."""
    renderer, normals = MeshRenderer(mesh), mesh.face_normals()
    shape = (grid.count,) * 3
    votes = Votes(*(np.zeros(shape, np.uint8) for _ in range(4)))
    for view in views:
        camera = shrink_camera(view.camera, RENDER_PX)
        size = (camera.width_px, camera.height_px)
        mask = cv2.resize(view.mask().astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) > 127
        hits = renderer.cast_rays(camera)
        face = hits.face[hits.mask]
        towards = camera.centre_in_world - mesh.vertices[mesh.faces[face, 0]]
        depth = np.zeros(mask.shape, np.float32)
        # Through a hole one sees the surface from behind: it says nothing of what lies before it.
        depth[hits.mask] = np.where(np.einsum("pc,pc->p", normals[face], towards) > 0, hits.depth[hits.mask], 0.0)
        off_px = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
        limits = np.array([MIXED_PX, FRONT_VOXELS * grid.side, BEHIND_VOXELS[0] * grid.side, BEHIND_VOXELS[1] * grid.side])
        _vote(grid.first, grid.side, camera.row, off_px, depth, limits, votes.framed, votes.outside, votes.empty, votes.solid)
    return votes


@numba.njit(cache=True, parallel=True)
def _vote(
    first: np.ndarray,
    side: float,
    row: np.ndarray,
    off_px: np.ndarray,
    depth: np.ndarray,
    limits: np.ndarray,
    framed: np.ndarray,
    outside: np.ndarray,
    empty: np.ndarray,
    solid: np.ndarray,
) -> None:
    """Add one view's votes; `row` as `Camera.row`, `limits`: mask margin in px, then front, behind from and behind to in depth."""
    count = framed.shape[0]
    height, width = off_px.shape
    for i in numba.prange(count):
        x = first[0] + i * side
        for j in range(count):
            y = first[1] + j * side
            for k in range(count):
                z = first[2] + k * side
                w = row[6] * x + row[7] * y + row[8] * z + row[11]
                if w <= 0.0:
                    continue
                u = int(np.floor((row[0] * x + row[1] * y + row[2] * z + row[9]) / w * row[12] + row[14]))
                v = int(np.floor((row[3] * x + row[4] * y + row[5] * z + row[10]) / w * row[13] + row[15]))
                if u < 0 or v < 0 or u >= width or v >= height:
                    continue
                framed[i, j, k] += 1
                if off_px[v, u] > limits[0]:
                    outside[i, j, k] += 1
                elif off_px[v, u] == 0.0 and depth[v, u] > 0.0:
                    behind = w - depth[v, u]
                    if behind < -limits[1]:
                        empty[i, j, k] += 1
                    elif limits[2] < behind < limits[3]:
                        solid[i, j, k] += 1
