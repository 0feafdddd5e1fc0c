"""Close the underside, which no photo shows while the object stands on its support.

Every open border near the support plane is extended down to the plane, and the hole there is closed by a flat face with a smooth
outline. The object touches its support there, and a closed bottom serves robots and pose estimators better than a hole. The added
faces are the last ones of the mesh and are marked as unseen; quality and grade ignore them. The texture step colours them like
their surroundings.
"""

from dataclasses import dataclass
from typing import Any

import manifold3d
import numpy as np

from zeroshop_steps.geometry.meshes.mesh_repair import make_plane_axes
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, number_edges

STATES = ("closed", "open")
# Lengths in diagonals of the object's bounding box.
NEAR_DIAGONALS = 0.05  # a wide border belongs to the underside if most of it is this close to the plane
FARTHEST_DIAGONALS = 0.15  # and none of it farther away: a hole in a wall may reach the ground, but it is no underside
MOST = 0.8  # share of the vertices of a border that "most of it" means
SMALL_NEAR_DIAGONALS = 0.015  # a small border, of a foot or of a hole through the object, must be closer to the plane
SMALL_SHARE = 0.1  # of the area of the widest border; smaller ones are small
SMOOTHED_DIAGONALS = (0.02, 0.05, 0.1, 0.2, 0.4)  # waves of the outline shorter than this are removed; tried until it is simple
FILTER_POWER = 8  # of that low-pass filter: waves half as long are damped to 1/257, waves twice as long keep 99.6 %
SIMPLE = 1e-4  # share of the area that may be covered upside down in an outline that counts as simple
FIRST_STEP = 0.01  # width of the outermost ring of the flat part, in diagonals of that part
GROWTH = 1.4  # of the rings' width, from one to the next: large triangles inside, small ones at the border


@dataclass(frozen=True)
class Underside:
    """What was closed, as mesh.json describes it.

    Attributes:
        state: closed or open.
        first_face, faces: index of the first added face, and how many were added; no photo shows them.
        borders: number of borders that were closed; left_open: number of those that were not.
        watertight: whether every edge now belongs to as many faces in one direction as in the other, so that the mesh bounds a solid.
    """

    state: str
    first_face: int
    faces: int
    borders: int
    left_open: int
    watertight: bool

    def as_record(self) -> dict[str, Any]:
        """The record for the JSON."""
        return {"seen": False, **self.__dict__}


def leave_open(mesh: Mesh) -> tuple[Mesh, Underside]:
    """The mesh as it is, and what that means; it may be closed already."""
    borders = find_open_borders(mesh.faces)
    return mesh, Underside("open" if borders else "closed", len(mesh.faces), 0, 0, len(borders), watertight=not borders)


def close_underside(mesh: Mesh, up: np.ndarray, bottom: float) -> tuple[Mesh, Underside]:
    """Close the borders near the plane up . x = bottom.

    Args:
        mesh: open or closed; its vertices and faces stay unchanged and come first.
        up: (3,) unit normal of the support plane, towards the object.
        bottom: height of the plane along `up`.

    Returns:
        The mesh with new normals, and what was added.
    """
    borders = find_open_borders(mesh.faces)
    chosen = _choose_borders(borders, mesh.vertices, up, bottom)
    if not chosen:
        return leave_open(mesh)
    ring = np.concatenate(chosen)
    after = np.concatenate([np.roll(border, -1) for border in chosen])
    foot = len(mesh.vertices) + np.arange(len(ring))  # below each vertex of the borders, on the plane
    foot_after = np.concatenate([np.roll(part, -1) for part in np.split(foot, np.cumsum([len(border) for border in chosen])[:-1])])
    skirt = np.concatenate([np.stack([after, ring, foot], 1), np.stack([after, foot, foot_after], 1)])
    across = make_plane_axes(up)[::-1]  # right-handed about the way down, which the flat faces show
    filled = _fill([mesh.vertices[border] @ across.T for border in chosen], float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))))
    if filled is None:
        return leave_open(mesh)
    points, flat = filled
    vertices = np.concatenate([mesh.vertices, points @ across + bottom * up])
    flat = flat + len(mesh.vertices)
    faces = np.concatenate([mesh.faces, skirt, flat])
    whole = Mesh(vertices, faces).with_normals()
    watertight = not find_open_borders(faces)
    added = len(faces) - len(mesh.faces)
    return whole, Underside("closed", len(mesh.faces), added, len(chosen), len(borders) - len(chosen), watertight)


def drop_underside(mesh: Mesh, metadata: dict[str, Any]) -> Mesh:
    """The mesh without the faces that the content of mesh.json marks as an unseen underside."""
    first = (metadata.get("underside") or {}).get("first_face", len(mesh.faces))
    return Mesh(mesh.vertices, mesh.faces[:first], mesh.normals, mesh.uv, mesh.texture, mesh.quality).without_loose_vertices()


def find_open_borders(faces: np.ndarray) -> list[np.ndarray]:
    """Closed chains of vertices along the edges of (F, 3) faces that no face uses in the other direction.

    At every vertex as many such edges end as begin, so all of them belong to chains. No chain passes a vertex twice.
    """
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, index = np.unique(number_edges(edges), return_inverse=True)
    forward = edges[:, 0] < edges[:, 1]
    balance = np.bincount(index, np.where(forward, 1, -1))[index]
    single = (balance != 0) & (forward == (balance > 0))
    following: dict[int, list[int]] = {}
    for start, end in np.unique(edges[single], axis=0):
        following.setdefault(int(start), []).append(int(end))
    borders = []
    for first in sorted(following):
        chain: list[int] = [first]
        while following[chain[-1]]:
            place = following[chain[-1]].pop()
            if place in chain:
                start = chain.index(place)
                borders.append(np.array(chain[start:]))
                del chain[start + 1 :]
            else:
                chain.append(place)
    return borders


def _choose_borders(borders: list[np.ndarray], vertices: np.ndarray, up: np.ndarray, bottom: float) -> list[np.ndarray]:
    """The borders that belong to the underside."""
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    heights = [np.abs(vertices[border] @ up - bottom) / diagonal for border in borders]
    areas = np.array([abs(up @ _vector_area(vertices[border])) for border in borders])
    near = [float((above < NEAR_DIAGONALS).mean()) >= MOST and float(above.max()) < FARTHEST_DIAGONALS for above in heights]
    wide = areas >= SMALL_SHARE * areas[near].max(initial=0.0)
    small = [float(np.quantile(above, MOST)) < SMALL_NEAR_DIAGONALS for above in heights]
    return [border for k, border in enumerate(borders) if near[k] and (wide[k] or small[k])]


def _vector_area(chain: np.ndarray) -> np.ndarray:
    """(3,) area enclosed by a closed (N, 3) chain, as a vector along its normal."""
    around = chain - chain.mean(0)
    return np.cross(around, np.roll(around, -1, 0)).sum(0) / 2


def _fill(borders: list[np.ndarray], diagonal: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices and faces in the plane inside closed (N, 2) chains, which are smoothed until they do not overlap; None if they still do."""
    for length in SMOOTHED_DIAGONALS:
        points, faces = _triangulate_rings([_smooth_outline(border, length * diagonal) for border in borders])
        (ax, ay), (bx, by), (cx, cy) = points[faces].transpose(1, 2, 0)
        areas = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if np.clip(-areas, 0.0, None).sum() < SIMPLE * np.abs(areas).sum():
            return points, faces
    return None


def _smooth_outline(chain: np.ndarray, length: float) -> np.ndarray:
    """A closed (N, 2) chain without waves shorter than `length` (Butterworth's low-pass filter)."""
    step = np.linalg.norm(chain - np.roll(chain, -1, 0), axis=1).sum() / len(chain)
    frequency = 2.0 * np.pi * np.fft.fftfreq(len(chain))
    kept = 1.0 / (1.0 + (frequency * length / (2.0 * np.pi * step)) ** FILTER_POWER)
    return np.fft.ifft(np.fft.fft(chain, axis=0) * kept[:, None], axis=0).real


def _triangulate_rings(rings: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate the plane inside an outline by rings that become coarser inwards, which avoids long thin triangles.

    Args:
        rings: closed (N, 2) chains as seen from below, in the direction of the borders.

    Returns:
        (M, 2) vertices, those of the rings first, and (T, 3) faces that face down.
    """
    ends = np.cumsum([len(ring) for ring in rings])
    index = [np.arange(end - len(ring), end)[::-1] for end, ring in zip(ends, rings, strict=True)]
    points, triangles = list(rings), []
    step = float(np.linalg.norm(np.ptp(np.concatenate(rings), axis=0))) * FIRST_STEP
    while True:
        everything = np.concatenate(points)
        section = manifold3d.CrossSection([everything[ring] for ring in index]).offset(-step, manifold3d.JoinType.Round)
        inset = [ring for ring in (_resample(ring, step) for ring in section.to_polygons()) if len(ring) > 2]
        first = len(everything) + np.cumsum([0, *map(len, inset)])
        inner = [np.arange(start, start + len(ring)) for start, ring in zip(first, inset, strict=False)]
        band = [*index, *(ring[::-1] for ring in inner)]
        points += inset
        everything = np.concatenate(points)
        triangles.append(np.concatenate(band)[manifold3d.triangulate([everything[ring] for ring in band], allow_convex=False)])
        if not inset:
            return everything, np.concatenate(triangles)
        index, step = inner, step * GROWTH


def _resample(ring: np.ndarray, step: float) -> np.ndarray:
    """The closed (N, 2) chain with points about `step` apart."""
    around = np.concatenate([ring, ring[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(around, axis=0), axis=1))])
    places = np.linspace(0.0, length[-1], max(int(length[-1] / step), 0), endpoint=False)
    return np.stack([np.interp(places, length, around[:, axis]) for axis in (0, 1)], 1)
