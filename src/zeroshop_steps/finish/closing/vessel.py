"""A closed mesh seen as a vessel: what is empty inside if its wall is about equally thick everywhere and it is open above.

Stereo and outlines measure the outside of a vessel. If its inside is plain, neither finds the inside, and the mesh has a lid or is
filled in part. Here, the inside is the outside moved inwards: all places farther from the outside of the wall than the wall is thick,
above a floor, up to the rim. The wall may grow evenly thicker towards the floor. The outside of the wall is the side of the horizontal
sections of the mesh with their holes filled, without what is much narrower than the section, such as a handle.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import manifold3d
import numpy as np
from scipy import ndimage
from skimage.measure import marching_cubes

from zeroshop_steps.finish.clean import simplify
from zeroshop_steps.geometry.meshes.mesh_repair import make_plane_axes
from zeroshop_steps.geometry.meshes.triangle_meshes import SAME_SIDE_COSINE, Mesh
from zeroshop_steps.geometry.observation.visual_hull import COARSE_VOXELS
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

RIM_VOXELS = 2
"""The highest section that is used lies this far below the top: rims are rounded."""
NARROW_SHARE = 0.4
"""Parts of a section narrower than this share of its widest part are no part of the body: handles, ears."""
CLOSED_VOXELS = 2
"""Gaps in a section's outline up to twice this wide are closed."""
OUTSIDE_VOXELS = 1.75
"""A face of the mesh within this distance of the side of the sections belongs to the outside of the wall, if it faces away from the
inside within 45 degrees: the lip does not."""
ATTACHED_VOXELS = 0.5
"""Where a handle covers the outside of the wall, the side of the sections counts, which is right to about this."""
WIDEST_WALL = 0.35
"""Of the largest distance from the outside: thicker walls leave no vessel."""
LEAST_MOUTH = 0.12
"""Radius of the largest circle in the section at the rim, in diagonals of the mesh; below, nothing could be seen inside."""
CAVITY_FACES, LEAST_FACES = 0.4, 2000
"""Triangles of a cavity, as a share of those that the mesh has on the same area, and the fewest."""


@dataclass(frozen=True)
class Vessel:
    """The outside of a vessel.

    Attributes:
        mesh: closed, facing outwards, in the frame of the registration.
        upright_from_registration: (3, 3) rotation; the third axis of the upright frame is up.
        first, side: the centre (3,) of the first voxel in the upright frame, and the distance between voxels.
        depth: (X, Y, Z) float32 distance inwards from the outside of the wall; 0 outside. Above the rim it continues as at the rim.
        bottom, rim: height of the lowest point and of the highest section along up.
        diagonal: of the box around the mesh.
    """

    mesh: Mesh
    upright_from_registration: np.ndarray
    first: np.ndarray
    side: float
    depth: np.ndarray
    bottom: float
    rim: float
    diagonal: float

    @property
    def thickest(self) -> float:
        """The thickest wall that leaves a vessel."""
        return WIDEST_WALL * float(self.depth.max())

    @cached_property
    def _solid(self) -> tuple[int, manifold3d.Manifold]:
        """The mesh as a solid, and its number; the next one is for cavities."""
        number = manifold3d.Manifold.reserve_ids(2)
        return number, _to_manifold(self.mesh, number)

    def cavity(self, wall: float, floor: float, taper: float = 0.0) -> Mesh | None:
        """The closed surface of what is empty, a little higher than the rim, facing outwards; None if there is nothing.

        Args:
            wall: thickness of the wall at the rim, in the unit of the mesh.
            floor: height of the floor above the lowest point of the mesh.
            taper: how much thicker the wall is one unit of length below the rim.
        """
        heights = self.first[2] + self.side * np.arange(self.depth.shape[2])
        thickness = wall + taper * np.maximum(self.rim - heights, 0.0)
        field = np.minimum(self.depth - thickness.astype(np.float32), (heights - self.bottom - floor).astype(np.float32))
        for axis in range(3):
            np.moveaxis(field, axis, 0)[[0, -1]] = -self.side
        parts, count = ndimage.label(field > 0)
        if count == 0:
            return None
        if count > 1:
            sizes = np.bincount(parts.ravel())
            sizes[0] = 0
            field[(parts > 0) & (parts != sizes.argmax())] = -0.1 * self.side
        vertices, faces, _, _ = marching_cubes(np.maximum(-field, -4 * np.float32(self.side)), 0.0)
        return Mesh((self.first + self.side * vertices.astype(float)) @ self.upright_from_registration, faces.astype(np.int64))

    def without(self, cavity: Mesh) -> tuple[Mesh, np.ndarray] | None:
        """The mesh without the cavity, and (F,) the face of `mesh` that each of its faces is a part of; -1 for the cavity's.

        Faces away from the cavity stay as they are. None where the mesh does not bound a solid.
        """
        number, solid = self._solid
        empty = _to_manifold(cavity, number + 1)
        if manifold3d.Error.NoError != solid.status() or manifold3d.Error.NoError != empty.status():
            return None
        cut = (solid - empty).to_mesh()
        faces, origin = np.asarray(cut.tri_verts, np.int64), np.asarray(cut.face_id, np.int64)
        ends = np.asarray(cut.run_index, np.int64) // 3
        for start, end, source in zip(ends[:-1], ends[1:], cut.run_original_id, strict=True):
            if source == number + 1:
                origin[start:end] = -1
        return Mesh(np.asarray(cut.vert_properties, float)[:, :3], faces), origin

    def simplified(self, cavity: Mesh) -> Mesh:
        """The cavity with fewer triangles: it is smooth, and can do with larger ones than the mesh has."""
        share = cavity.face_areas().sum() / self.mesh.face_areas().sum()
        return simplify(cavity, max(int(CAVITY_FACES * share * len(self.mesh.faces)), LEAST_FACES), 0)


def has_room_for_mouth(mesh: Mesh, up: np.ndarray) -> bool:
    """Whether a closed mesh is so wide at its top, along the (3,) unit vector `up`, that one could see into it there."""
    points, low, side, rim, diagonal = _stand_up(mesh, up)
    section = _to_manifold(Mesh(points, mesh.faces), manifold3d.Manifold.reserve_ids(1)).slice(rim)
    picture = np.zeros(np.ceil(np.ptp(points[:, 1::-1], axis=0) / side).astype(int) + 5, np.uint8)
    for outline in section.to_polygons():
        cv2.fillPoly(picture, [np.rint((np.asarray(outline) - low[:2]) / side + 2).astype(np.int32)], 1)
    return float(cv2.distanceTransform(picture, cv2.DIST_L2, 5).max()) * side >= LEAST_MOUTH * diagonal


def measure_vessel(mesh: Mesh, up: np.ndarray) -> Vessel:
    """What a closed mesh, facing outwards, would be as a vessel that is open above, along the (3,) unit vector `up`."""
    points, low, side, rim, diagonal = _stand_up(mesh, up)
    first, count = low - 2.5 * side, np.ceil(np.ptp(points, axis=0) / side).astype(int) + (5, 5, 9)
    centres = (first + side * np.indices(count).reshape(3, -1).T).astype(np.float32)
    solid = ray_caster((points, mesh.faces)).compute_occupancy(o3d.core.Tensor(centres)).numpy().reshape(count) > 0
    body = _find_body(solid, int(np.floor((rim - first[2]) / side)))
    depth = _measure_depth(body, Mesh(points, mesh.faces), first, side)
    return Vessel(mesh, _upright(up), first, side, depth, float(low[2]), rim, diagonal)


def _upright(up: np.ndarray) -> np.ndarray:
    return np.vstack([make_plane_axes(up), up])


def _stand_up(mesh: Mesh, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float, float]:
    """(V, 3) vertices in the upright frame, their lowest corner (3,), the side of a voxel, the rim's height, and the diagonal."""
    points = mesh.vertices @ _upright(up).T
    size = np.ptp(points, axis=0)
    side = float(size.max()) / COARSE_VOXELS
    return points, points.min(0), side, float(points[:, 2].max()) - RIM_VOXELS * side, float(np.linalg.norm(size))


def _find_body(solid: np.ndarray, rim: int) -> np.ndarray:
    """(X, Y, Z) bool: sections without holes and narrow parts; above the section `rim` and below the lowest one as these."""
    body = np.zeros_like(solid)
    lowest = int(np.flatnonzero(solid.any((0, 1)))[0])
    for level in range(lowest, rim + 1):
        section = np.pad(solid[:, :, level], CLOSED_VOXELS + 1)
        section = ndimage.binary_fill_holes(ndimage.binary_closing(section, iterations=CLOSED_VOXELS))
        inwards = cv2.distanceTransform(section.astype(np.uint8), cv2.DIST_L2, 5)
        radius = NARROW_SHARE * inwards.max()
        section &= cv2.distanceTransform((inwards <= radius).astype(np.uint8), cv2.DIST_L2, 5) <= radius + 0.5
        parts, count = ndimage.label(section)
        if count > 1:
            section = parts == 1 + np.bincount(parts.ravel())[1:].argmax()
        body[:, :, level] = section[CLOSED_VOXELS + 1 : -CLOSED_VOXELS - 1, CLOSED_VOXELS + 1 : -CLOSED_VOXELS - 1]
    body[:, :, rim + 1 :] = body[:, :, rim, None]
    body[:, :, :lowest] = body[:, :, lowest, None]
    return body


def _measure_depth(body: np.ndarray, mesh: Mesh, first: np.ndarray, side: float) -> np.ndarray:
    """(X, Y, Z) float32 distance inwards from the outside of the wall, which the mesh itself gives where it can.

    Args:
        body: (X, Y, Z) bool, the filled sections.
        mesh, first: in the upright frame.
        side: of a voxel.
    """
    ends = body.shape[2] // 3  # neither the top nor the bottom of the block is a wall
    depth = ndimage.distance_transform_edt(np.pad(body, ((0, 0), (0, 0), (ends, ends)), mode="edge"))[:, :, ends:-ends] * side
    middle, normals = mesh.vertices[mesh.faces].mean(1), mesh.face_normals()
    cell = tuple(np.clip(np.rint((middle - first) / side).astype(int), 0, np.array(body.shape) - 1).T)
    inwards = np.stack([ndimage.uniform_filter(slope, 3)[cell] for slope in np.gradient(depth, side)], 1)
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-12)
    outside = (depth[cell] < OUTSIDE_VOXELS * side) & (np.einsum("fc,fc->f", normals, inwards) < -SAME_SIDE_COSINE)
    outside &= (middle[:, 2] > mesh.vertices[:, 2].min() + 2 * side) | (normals[:, 2] > -SAME_SIDE_COSINE)
    if outside.any():
        near = np.argwhere((depth > 0) & (depth < WIDEST_WALL * depth.max() + 2 * side))
        wall = ray_caster((mesh.vertices, mesh.faces[outside]))
        exact = wall.compute_distance(o3d.core.Tensor((first + side * near).astype(np.float32))).numpy()
        place = tuple(near.T)
        depth[place] = np.minimum(exact, depth[place] + ATTACHED_VOXELS * side)
    return depth.astype(np.float32)


def _to_manifold(mesh: Mesh, number: int) -> manifold3d.Manifold:
    """A solid for Boolean operations, whose faces keep their indices under this number."""
    return manifold3d.Manifold(
        manifold3d.Mesh(
            mesh.vertices.astype(np.float32),
            mesh.faces.astype(np.uint32),
            run_index=np.array([0, 3 * len(mesh.faces)], np.uint32),
            run_original_id=np.array([number], np.uint32),
            face_id=np.arange(len(mesh.faces), dtype=np.uint32),
        )
    )
