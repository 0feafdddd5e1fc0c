"""Close a surface everywhere: what photos measured stays, holes are filled by the smoothest surface that the photos allow.

Space around the mesh is divided into voxels. Photos vote: a voxel outside of several masks, or in front of measured surface, is
empty; one just behind measured surface is solid. Near the mesh the mesh itself decides. Between, the occupancy minimizes its
votes and its surface area (`surface.free_space`, Kolev et al. 2009), so that a hole is closed where no photo looks through it.
The result is a signed distance: the mesh's own near measured surface, elsewhere the closed shape's, blended by diffusion from
the rims of the holes (Davis et al., Filling holes in complex surfaces using volumetric diffusion, 3DPVT 2002). Marching cubes
(Lorensen and Cline 1987) makes a closed mesh of it, whose vertices are put back onto the measured surface.

Where masks do not bound the object, as where it is cut off or seen from one side, nothing lies beyond the convex hull of what was
measured and of its shadow on the support plane. Where that plane is known, the object ends there; where it is not, just below the lowest
measured surface. In a thin layer above a known plane, where masks often hold a strip of ground, nothing stays that lies outside of the
object's cross-section above that layer.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull
from skimage.measure import marching_cubes

from zeroshop_steps.finish.closing.generated import GeneratedShape
from zeroshop_steps.finish.closing.measured_surface import MeasuredSurface
from zeroshop_steps.finish.closing.voxel_votes import Grid, Votes, cast_votes
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.meshes.mesh_repair import label_parts
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.support.ground_plane import Plane
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster
from zeroshop_steps.surface.mvs.free_space import minimize_surface

COARSE, FINE = 128, 256
"""Voxels along the longest side: of the votes, and of the signed distance."""
OUTSIDE_VIEWS, OUTSIDE_SHARE = 2, 0.2
"""A voxel outside of at least so many masks, and of this share of those that frame it, is empty: single masks may be wrong."""
SOLID_WEIGHT, FULL_VOTES, FILL = 2.0, 3.0, 0.1
"""As in `surface.free_space`: what a vote for solid weighs, how many votes count fully, and the lean to solid without any."""
MEASURED_VOTE = 2.0
"""Vote of the mesh itself near measured surface, in full votes of the photos."""
SMOOTHNESS, STEPS = 0.3, 200
GUESS_VOTE = 1.0
"""Vote of a generated shape where the photos say nothing, in full votes of the photos."""
ASKED_VOXELS, AGREED_VOXELS, JOIN_VOXELS = 2.0, 1.5, 3.0
"""Coarse voxels: this near to the closed shape, and where that is this near to the generated one, the distance of the latter is taken;
and this near to measured surface, the two are joined."""
NEAR_VOXELS = 2.0
"""Within this many coarse voxels of the mesh its own signed distance counts."""
PART_SHARE = 0.05
"""Closed parts smaller than this share of the largest are dropped, first by the measured surface that they hold."""
BAND_VOXELS = 6.0
DIFFUSION_STEPS = 60
"""Reaches about eight fine voxels from the rims; farther inside a hole the smooth closed shape counts."""
GROUND_DIAGONALS, GROUND_HEIGHTS = 0.02, 0.05
"""The layer above the support plane in which masks may hold ground: in diagonals of the object, at most this share of its height."""
FLAT_COSINE = 0.7
"""Ground faces up within 45 degrees: stereo on plain ground is rough."""
SNAP_VOXELS = 0.75
"""Vertices this near to measured surface, in fine voxels, are put onto it."""


@dataclass(frozen=True)
class GroundPlane(Plane):
    """The support plane, with its unit normal towards the object, in the mesh's frame.

    Attributes:
        found: whether points or views showed it. Otherwise it only bounds what is closed: it lies just below the measured surface.
    """

    found: bool = True

    def ground_layer(self, mesh: Mesh) -> float:
        """Thickness of the layer above the plane in which masks may hold ground; 0 for a plane that was not found."""
        if not self.found:
            return 0.0
        diagonal, height = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))), float(self.heights(mesh.vertices).max())
        return min(GROUND_DIAGONALS * diagonal, GROUND_HEIGHTS * height)

    def ground_share(self, mesh: Mesh) -> float:
        """Share of the mesh's area that lies flat within this layer, facing up: ground that the masks hold."""
        low = (self.heights(mesh.vertices)[mesh.faces] < self.ground_layer(mesh)).all(1)
        areas = mesh.face_areas()
        return float(areas[low & (mesh.face_normals() @ self.normal > FLAT_COSINE)].sum() / max(areas.sum(), 1e-30))


def close_surface(mesh: Mesh, views: Sequence[View], plane: GroundPlane | None, guess: GeneratedShape | None = None) -> Mesh:
    """A closed mesh that keeps the measured surface; the module's text says how.

    Args:
        mesh: cleaned, with open borders, facing outwards, in the frame of the views' cameras.
        views: registered photos with masks.
        plane: what the object stands on, or ends at.
        guess: what a generated shape says where the photos say nothing; without it, the surface is as small as it can be.
    """
    mesh = mesh.with_normals()
    surface = MeasuredSurface(mesh)
    coarse, fine = Grid.around(mesh, COARSE), Grid.around(mesh, FINE)
    occupied = _occupancy(coarse, surface, cast_votes(coarse, mesh, views), plane, guess)
    distance = _signed_distance(fine, coarse, occupied, surface, guess)
    if plane is not None:
        _end_at_plane(distance, fine, plane, plane.ground_layer(mesh))
    closed = _without_small_parts(_extract(distance, fine))
    return surface.snapped(closed, SNAP_VOXELS * fine.side)


def _occupancy(grid: Grid, surface: MeasuredSurface, votes: Votes, plane: GroundPlane | None, guess: GeneratedShape | None) -> np.ndarray:
    """(R, R, R) bool: the closed shape that votes and smoothness agree on."""
    empty, solid = votes.empty.astype(np.float32), votes.solid.astype(np.float32)
    outside = votes.outside.astype(np.float32)
    allowed = ~((outside >= OUTSIDE_VIEWS) & (outside >= OUTSIDE_SHARE * votes.framed))
    bounded = _is_bounded(grid, allowed, plane)
    allowed[[0, -1]] = allowed[:, [0, -1]] = allowed[:, :, [0, -1]] = False
    data = np.clip((empty - 1.0 - SOLID_WEIGHT * solid) / FULL_VOTES, -1.0, 1.0).astype(np.float32)
    undecided = (empty <= 1) & (solid == 0)
    data[undecided] = -FILL
    if guess is not None or not bounded:
        asked = np.argwhere(undecided & allowed)
        places, vote = grid.centres(asked), FILL if guess is None else GUESS_VOTE
        inside = _lies_in_convex_hull(places, surface.mesh, plane) if guess is None else guess.contains(places)
        data[tuple(asked.T)] = np.where(inside, -vote, vote)
    index = np.argwhere(allowed)
    centres = grid.centres(index)
    if plane is not None:
        above = plane.heights(centres) > 0
        allowed[tuple(index[~above].T)] = False
        index, centres = index[above], centres[above]
    distance, known = surface.signed_distance(centres, NEAR_VOXELS * grid.side)
    data[tuple(index[known].T)] = np.where(distance[known] > 0, MEASURED_VOTE, -MEASURED_VOTE)
    occupied = minimize_surface(np.where(allowed, data, np.float32(1)), allowed, SMOOTHNESS, STEPS) > 0.5
    return ndimage.binary_fill_holes(_keep_measured_parts(occupied, tuple(index[known].T)))


def _is_bounded(grid: Grid, allowed: np.ndarray, plane: GroundPlane | None) -> bool:
    """Whether masks bound what may be solid, (R, R, R) bool, within the block of voxels; below the plane, that does it."""
    border = np.ones(allowed.shape, bool)
    border[1:-1, 1:-1, 1:-1] = False
    reached = np.argwhere(border & allowed)
    if plane is not None and len(reached):
        reached = reached[plane.heights(grid.centres(reached)) > 0]
    return not len(reached)


def _lies_in_convex_hull(points: np.ndarray, mesh: Mesh, plane: GroundPlane | None) -> np.ndarray:
    """(P,) bool: points in the convex hull of a mesh and of its shadow on the plane."""
    corners = mesh.vertices
    if plane is not None and plane.found:
        corners = np.concatenate([corners, corners - plane.heights(corners)[:, None] * plane.normal])
    hull = ConvexHull(corners)
    # Qhull's faces are turned any way; signed distances by rays do not mind.
    scene = ray_caster((corners, hull.simplices))
    return np.asarray(scene.compute_occupancy(o3d.core.Tensor(points.astype(np.float32))).numpy() > 0)


def _keep_measured_parts(occupied: np.ndarray, measured: tuple[np.ndarray, ...]) -> np.ndarray:
    """The (R, R, R) bool parts with at least `PART_SHARE` of the voxels at these places, near the surface, that any part has: what has
    none lies where no photo looks, such as above what was filmed from one side."""
    labels, count = ndimage.label(occupied)
    if count < 2:
        return occupied
    held = np.bincount(labels[measured], minlength=count + 1)
    held[0] = 0
    return np.isin(labels, np.flatnonzero(held >= max(1, PART_SHARE * held.max()))) if held.any() else occupied


def _signed_distance(fine: Grid, coarse: Grid, occupied: np.ndarray, surface: MeasuredSurface, guess: GeneratedShape | None) -> np.ndarray:
    """(N, N, N) float32 distance, positive outside: near measured surface its own, else that of the closed shape.

    A generated shape keeps its own distance where the closed shape agrees with it, up to a few voxels from measured surface.
    """
    voxels = ndimage.distance_transform_edt(~occupied) - ndimage.distance_transform_edt(occupied)
    smooth = ndimage.gaussian_filter(voxels.astype(np.float32), 1.0) * np.float32(coarse.side)
    distance = ndimage.zoom(smooth, fine.count // coarse.count, order=1, grid_mode=True, mode="nearest")
    limit = BAND_VOXELS * coarse.side
    index = np.argwhere(np.abs(distance) < limit)
    own, near = surface.signed_distance(fine.centres(index), NEAR_VOXELS * coarse.side)
    np.clip(distance, -limit, limit, out=distance)
    distance[tuple(index[near].T)] = own[near]
    free = ~near
    if guess is not None:
        asked = np.flatnonzero(free & (np.abs(distance[tuple(index.T)]) < ASKED_VOXELS * coarse.side))
        theirs = guess.signed_distance(fine.centres(index[asked]))
        agreed = np.abs(theirs - distance[tuple(index[asked].T)]) < AGREED_VOXELS * coarse.side
        distance[tuple(index[asked[agreed]].T)] = theirs[agreed]
        free[asked[agreed]] = surface.may_reach(fine.centres(index[asked[agreed]]), JOIN_VOXELS * coarse.side)
    _diffuse(distance, np.ascontiguousarray(index[free]), DIFFUSION_STEPS)
    return distance


@numba.njit(cache=True, parallel=True)
def _diffuse(values: np.ndarray, index: np.ndarray, steps: int) -> None:
    """Replace values at the voxels (P, 3) by the mean of their six neighbours, `steps` times (Jacobi), in place."""
    count = len(index)
    fresh = np.empty(count, np.float32)
    last = values.shape[0] - 1
    for _ in range(steps):
        for p in numba.prange(count):
            i, j, k = index[p]
            i0, i1, j0, j1, k0, k1 = max(i - 1, 0), min(i + 1, last), max(j - 1, 0), min(j + 1, last), max(k - 1, 0), min(k + 1, last)
            total = values[i0, j, k] + values[i1, j, k] + values[i, j0, k] + values[i, j1, k] + values[i, j, k0] + values[i, j, k1]
            fresh[p] = total / np.float32(6)
        for p in numba.prange(count):
            values[index[p, 0], index[p, 1], index[p, 2]] = fresh[p]


def _end_at_plane(distance: np.ndarray, grid: Grid, plane: GroundPlane, layer: float) -> None:
    """Leave nothing below the plane, nor in the layer above it outside of the cross-section at the layer's top; changes `distance`.

    What the cross-section encloses stays: the floor of a bowl may lie in the layer.
    """
    index = np.indices(distance.shape, dtype=np.float32).reshape(3, -1)
    heights = plane.normal @ (grid.first[:, None] + grid.side * index) - plane.offset
    low = np.flatnonzero(heights < layer)
    axes = np.linalg.svd(plane.normal[None])[2][1:]
    middle = grid.first + grid.side * (grid.count - 1) / 2
    foot = middle - (plane.normal @ middle - plane.offset - layer) * plane.normal
    half = 0.9 * grid.count * grid.side  # the block's half diagonal, seen from any side
    along = np.arange(-half, half, grid.side)
    places = foot + along[:, None, None] * axes[0] + along[None, :, None] * axes[1]
    section = ndimage.map_coordinates(distance, ((places - grid.first) / grid.side).reshape(-1, 3).T, order=1, mode="nearest")
    inside = ndimage.binary_fill_holes(section.reshape(len(along), -1) < 0)
    if not inside.any():
        return
    outline = (ndimage.distance_transform_edt(~inside) - ndimage.distance_transform_edt(inside)) * grid.side
    points = (grid.first[:, None] + grid.side * index[:, low]) - foot[:, None]
    cells = (axes @ points + half) / grid.side
    off = ndimage.map_coordinates(outline.astype(np.float32), cells, order=1, mode="nearest")
    flat = distance.reshape(-1)
    flat[low] = np.maximum(np.maximum(flat[low], off), -heights[low])


def _extract(distance: np.ndarray, grid: Grid) -> Mesh:
    """The zero level as a closed mesh that faces outwards."""
    limit = np.float32(grid.side)
    distance[[0, -1]] = np.maximum(distance[[0, -1]], limit)
    distance[:, [0, -1]] = np.maximum(distance[:, [0, -1]], limit)
    distance[:, :, [0, -1]] = np.maximum(distance[:, :, [0, -1]], limit)
    vertices, faces, _, _ = marching_cubes(distance, 0.0)
    return Mesh(grid.first + grid.side * vertices.astype(float), faces.astype(np.int64))


def _without_small_parts(mesh: Mesh) -> Mesh:
    """The mesh without closed parts far smaller than the largest, by area."""
    labels = label_parts(mesh.faces)
    areas = np.bincount(labels, mesh.face_areas())
    kept = (areas >= PART_SHARE * areas.max())[labels]
    return Mesh(mesh.vertices, mesh.faces[kept]).without_loose_vertices()
