"""The mesh of the decoder's grid, by the equations of FlexiCubes (Shen et al., ACM TOG 2023, sections 4.2 to 4.4).

A dual method: where the surface crosses an edge of the displaced grid follows from the signed distances at its ends, weighed by alpha;
the vertex of a patch is the mean of the crossings around it, weighed by beta; and each crossed edge is a quadrilateral between the four
cubes around it, split along the diagonal whose gammas are larger. The patches are those of `cube_patches`, so the mesh is closed and
each of its edges belongs to two faces, except where the surface leaves the grid.
"""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.networks.trellis.cube_patches import CORNERS, EDGES, four_edges_in_one_patch, patches_of_cubes

WEIGHT_RANGE = 0.99
"""Alpha and beta lie between 0.01 and 1.99, gamma between 0.005 and 0.995, as the decoder was trained."""
OUTSIDE = 1.0
"""Signed distance where there is no voxel."""
MOST_ROUNDS = 50
"""In which faces are connected in the other way; a few are enough."""


@dataclass(frozen=True)
class CubeFeatures:
    """What the decoder says of C cubes of a grid with `resolution` of them along each edge.

    Attributes:
        places: (C, 3) int64.
        distances: (C, 8) signed distances at the corners, negative inside; the cubes around a corner are averaged.
        shifts: (C, 8, 3) by how much a corner is displaced, before tanh; at most half a cube.
        colors: (C, 8, 3) before the logistic function.
        weights: (C, 21) alpha's place is 12 to 20, beta's 0 to 12, gamma's 20.
    """

    resolution: int
    places: np.ndarray
    distances: np.ndarray
    shifts: np.ndarray
    colors: np.ndarray
    weights: np.ndarray

    @staticmethod
    def split(resolution: int, places: np.ndarray, features: np.ndarray) -> "CubeFeatures":
        """From the (C, 101) features of the decoder, whose signed distances are learned up to one cube."""
        count = len(features)
        colors = features[:, 53:101].reshape(count, 8, 6)[..., :3]
        return CubeFeatures(
            resolution,
            places,
            features[:, :8] - 1.0 / resolution,
            features[:, 8:32].reshape(count, 8, 3),
            colors,
            features[:, 32:53],
        )


@dataclass(frozen=True)
class ColoredSurface:
    """A triangle mesh: (V, 3) vertices in the cube from -1/2 to 1/2, (F, 3) faces that face outwards, (V, 3) colours from 0 to 1."""

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray


@dataclass(frozen=True)
class _Corners:
    """The grid's corners that the decoder describes, by increasing key: signed distance, position and colour."""

    keys: np.ndarray
    distances: np.ndarray
    positions: np.ndarray
    colors: np.ndarray


def extract_surface(cubes: CubeFeatures) -> ColoredSurface:
    """The surface between inside and outside; without any, it has no faces."""
    corners = _average_corners(cubes)
    places = _find_crossed_cubes(corners, cubes.resolution)
    distances, positions, colors = _look_up_corners(corners, places, cubes.resolution)
    inside = ((distances < 0) << np.arange(8)).sum(1)
    crossed = (inside > 0) & (inside < 255)
    places, distances, positions, colors, inside = (part[crossed] for part in (places, distances, positions, colors, inside))
    patches = _connect(places, inside, cubes.resolution)
    weights = _look_up_weights(cubes, places)
    first = np.concatenate([[0], np.cumsum(patches.max(1, initial=-1) + 1)])
    index = np.where(patches >= 0, first[:-1, None] + patches, -1)
    vertices, vertex_colors = _place_vertices(index, int(first[-1]), distances, positions, colors, weights)
    gammas = np.zeros(int(first[-1]))
    gammas[index[index >= 0]] = np.broadcast_to(weights[:, 20:], index.shape)[index >= 0]
    faces = _connect_vertices(places, distances, index, gammas, cubes.resolution)
    return ColoredSurface(vertices, faces, vertex_colors)


def _keys(places: np.ndarray, resolution: int) -> np.ndarray:
    """One number for each place of a grid with `resolution` + 1 corners along each edge, and a margin of one."""
    side = resolution + 3
    return ((places[..., 0] + 1) * side + places[..., 1] + 1) * side + places[..., 2] + 1


def _average_corners(cubes: CubeFeatures) -> _Corners:
    """The corners' values: means over the cubes around each."""
    around = cubes.places[:, None] + CORNERS
    keys, first, index = np.unique(_keys(around, cubes.resolution).ravel(), return_index=True, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index, minlength=len(keys))

    def average(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(index), -1)
        return np.stack([np.bincount(index, column, len(keys)) / count for column in flat.T], 1)

    shifts = np.tanh(average(cubes.shifts)) * 0.5
    positions = (around.reshape(-1, 3)[first] + shifts) / cubes.resolution - 0.5
    return _Corners(keys, average(cubes.distances)[:, 0], positions, 1 / (1 + np.exp(-average(cubes.colors))))


def _find_crossed_cubes(corners: _Corners, resolution: int) -> np.ndarray:
    """(C, 3) cubes of the grid with a corner inside, in the order of their keys."""
    side = resolution + 3
    keys = corners.keys[corners.distances < 0]
    places = np.stack([keys // side**2, keys // side % side, keys % side], 1) - 1
    around = (places[:, None] - CORNERS).reshape(-1, 3)
    around = around[((around >= 0) & (around < resolution)).all(1)]
    _, first = np.unique(_keys(around, resolution), return_index=True)
    return around[first]


def _look_up_corners(corners: _Corners, places: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(C, 8) distances, (C, 8, 3) positions and (C, 8, 3) colours of the corners of cubes; outside where the decoder has no voxel."""
    around = places[:, None] + CORNERS
    if len(corners.keys) == 0 or len(places) == 0:
        return np.empty((0, 8)), np.empty((0, 8, 3)), np.empty((0, 8, 3))
    keys = _keys(around, resolution)
    found = np.searchsorted(corners.keys, keys).clip(max=len(corners.keys) - 1)
    there = corners.keys[found] == keys
    positions = np.where(there[..., None], corners.positions[found], around / resolution - 0.5)
    return np.where(there, corners.distances[found], OUTSIDE), positions, np.where(there[..., None], corners.colors[found], 0.5)


def _look_up_weights(cubes: CubeFeatures, places: np.ndarray) -> np.ndarray:
    """(C, 21) the weights of cubes within their ranges; neutral where the decoder has no voxel."""
    keys = _keys(cubes.places, cubes.resolution)
    order = np.argsort(keys)
    wanted = _keys(places, cubes.resolution)
    found = order[np.searchsorted(keys, wanted, sorter=order).clip(max=len(keys) - 1)]
    raw = np.where((keys[found] == wanted)[:, None], cubes.weights[found], 0.0)
    return np.concatenate([1 + WEIGHT_RANGE * np.tanh(raw[:, :20]), (1 - WEIGHT_RANGE) / 2 + WEIGHT_RANGE / (1 + np.exp(-raw[:, 20:]))], 1)


def _connect(places: np.ndarray, inside: np.ndarray, resolution: int) -> np.ndarray:
    """(C, 12) patches of the cubes' edges, such that no two patches share more than one edge across a face."""
    flipped = np.zeros(len(places), np.int64)
    patches = patches_of_cubes(inside, flipped)
    keys = _keys(places, resolution)
    order = np.argsort(keys)
    following = []
    for axis in range(3):
        wanted = _keys(places + np.eye(3, dtype=np.int64)[axis], resolution)
        found = order[np.searchsorted(keys, wanted, sorter=order).clip(max=max(len(keys) - 1, 0))] if len(keys) else wanted
        following.append(np.where(keys[found] == wanted, found, -1) if len(keys) else found)
    for _ in range(MOST_ROUNDS):
        faults = []
        for axis in range(3):
            here = np.flatnonzero((following[axis] >= 0) & four_edges_in_one_patch(patches, 2 * axis + 1))
            there = following[axis][here]
            both = four_edges_in_one_patch(patches[there], 2 * axis)
            faults += [(int(a), int(b), axis) for a, b in zip(here[both], there[both], strict=True)]
        if not faults:
            break
        touched: set[int] = set()
        for a, b, axis in faults:  # one face of a cube at a time: flips of two could undo each other
            if not {a, b} & touched:
                flipped[a] ^= 1 << (2 * axis + 1)
                flipped[b] ^= 1 << (2 * axis)
                touched |= {a, b}
        changed = np.array(sorted(touched))
        patches[changed] = patches_of_cubes(inside[changed], flipped[changed])
    return patches


def _place_vertices(
    index: np.ndarray, count: int, distances: np.ndarray, positions: np.ndarray, colors: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) positions and colours of the patches' vertices (equations 4 and 5 of the paper)."""
    cube, edge = np.nonzero(index >= 0)
    start, end = EDGES[edge].T
    ahead = (distances[cube, start] * weights[cube, 12 + start])[:, None]
    behind = (distances[cube, end] * weights[cube, 12 + end])[:, None]
    vertex, share = index[cube, edge], weights[cube, edge]
    total = np.bincount(vertex, share, count)

    def average(values: np.ndarray) -> np.ndarray:
        crossing = (ahead * values[cube, end] - behind * values[cube, start]) / (ahead - behind)
        return np.stack([np.bincount(vertex, share * column, count) / total for column in crossing.T], 1)

    return average(positions), np.clip(average(colors), 0.0, 1.0)


def _connect_vertices(places: np.ndarray, distances: np.ndarray, index: np.ndarray, gammas: np.ndarray, resolution: int) -> np.ndarray:
    """(F, 3) faces: two for each crossed edge of the grid that has four cubes around it."""
    keys = _keys(places, resolution)
    order = np.argsort(keys)
    faces = []
    for axis in range(3):
        first, second = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        # The cube whose lowest corner starts the edge knows it as the edge at that corner; so each edge is met once.
        at_corner = [_edge_at(axis, a, b) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
        around = np.stack([places, places - first, places - first - second, places - second])
        found = order[np.searchsorted(keys, _keys(around, resolution), sorter=order).clip(max=max(len(keys) - 1, 0))]
        whole = (keys[found] == _keys(around, resolution)).all(0) & (index[:, at_corner[0]] >= 0)
        quads = np.stack([index[cubes[whole], edge] for cubes, edge in zip(found, at_corner, strict=True)], 1)
        outwards = distances[whole, 0] < 0  # the edge leaves the inside along the axis, which the faces then face
        quads = np.where(outwards[:, None], quads, quads[:, ::-1])
        strength = gammas[quads]
        along = strength[:, 0] * strength[:, 2] > strength[:, 1] * strength[:, 3]
        faces += [quads[along][:, [0, 1, 2]], quads[along][:, [0, 2, 3]], quads[~along][:, [0, 1, 3]], quads[~along][:, [1, 2, 3]]]
    return np.concatenate(faces)


def _edge_at(axis: int, along_first: int, along_second: int) -> int:
    """The edge along an axis, at these coordinates of a cube on the following two axes."""
    base = along_first << (axis + 1) % 3 | along_second << (axis + 2) % 3
    return next(edge for edge, ends in enumerate(EDGES) if set(ends) == {base, base | 1 << axis})
