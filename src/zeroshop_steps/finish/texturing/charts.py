"""Cut a surface into charts, each of which a parallel projection flattens.

Reconstructed surfaces are rough. Charts that followed every bump would be thousands of scraps, so the directions of the
projections are taken from a smoothed copy of the surface.
"""

import numpy as np
from numba import njit
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from zeroshop_steps.geometry.meshes.surface_fields import BROAD_SMOOTHING, LIGHT_SMOOTHING, build_neighbour_matrix, smooth
from zeroshop_steps.geometry.meshes.triangle_meshes import FACING_COSINE, Mesh
from zeroshop_steps.geometry.observation.visibility import GRAZING_COSINE

# A step averages over direct neighbours, so its reach grows with the edges. The numbers of steps suit meshes of about 45,000 faces.
SMOOTHING = 15  # steps for the copy that gives the directions; fewer leave bumps that break charts, more round the object's edges
DIRECTIONS = 14  # at most, before those are merged that are close
MERGE_DEG = 30.0  # directions closer than this become one: a projection shows a face 30 degrees off with 87 % of its width
SMALL_SHARE = 2e-3  # of the surface; a smaller chart joins a neighbour that can show it
TINY_SHARE = 2e-4  # of the surface; a smaller chart joins a neighbour even if it folds there: a few wrong texels beat a scrap
MAX_LAYERS = 5  # rounds in which hidden parts of a chart are split off; what is still hidden then becomes one chart a face
SAMPLED_FACES = 5000  # directions are clustered on about so many faces: enough for 14 means, and quick
KMEANS_ROUNDS, JOIN_ROUNDS = 12, 8  # bounds of the time; joining ends sooner where nothing changes any more
GRID_CELLS = 2e7  # of the overlap test at most: 20 MB


def cut_into_charts(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Cut a mesh whose seams are not split yet.

    Returns:
        chart: (F,) chart of each face. Charts are connected and do not overlap themselves, except for folds of a few texels.
        flat: (F, 3, 2) projected corners, in the mesh's unit.
    """
    neighbours = build_neighbour_matrix(mesh)
    broad = smooth(mesh.vertices - mesh.vertices.mean(0), neighbours, SMOOTHING).astype(float)
    corners = broad[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(areas, 1e-30)[:, None]
    directions = find_main_directions(normals, areas)
    pairs = find_adjacent_faces(mesh.faces)
    label = _label_faces(normals, areas, directions, pairs)
    chart = _label_connected(label, pairs)
    right, up = _projection_axes(directions)
    light = smooth(mesh.vertices - mesh.vertices.mean(0), neighbours, LIGHT_SMOOTHING).astype(float)[mesh.faces]
    flat = np.stack([np.einsum("fcj,fj->fc", light, right[label]), np.einsum("fcj,fj->fc", light, up[label])], -1)
    height = np.einsum("fcj,fj->fc", corners, directions[label]).mean(1)
    for layer in range(1, MAX_LAYERS + 1):  # what lies behind another part of its chart becomes a chart of its own
        behind = _drop_tiny_groups(find_overlapped_faces(chart, flat, height), pairs, areas)
        if not behind.any():
            break
        label = label + np.where(behind, layer * 1000, 0)
        chart = _label_connected(label, pairs)
    else:
        chart = np.where(behind, chart.max() + 1 + np.arange(len(chart)), chart)
    return np.unique(chart, return_inverse=True)[1], flat


def find_main_directions(normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """(D, 3) directions that the surface faces most: spherical k-means from a farthest-first start, near ones merged."""
    step = max(1, len(normals) // SAMPLED_FACES)
    normals, areas = normals[::step], areas[::step]
    mean = [normals[areas.argmax()]]
    for _ in range(DIRECTIONS - 1):
        mean.append(normals[(normals @ np.array(mean).T).max(1).argmin()])
    directions = np.array(mean)
    for _ in range(KMEANS_ROUNDS):
        nearest = (normals @ directions.T).argmax(1)
        sums = np.zeros_like(directions)
        np.add.at(sums, nearest, normals * areas[:, None])
        length = np.linalg.norm(sums, axis=1)
        directions = sums[length > 0] / length[length > 0, None]
    weight = np.bincount((normals @ directions.T).argmax(1), areas, len(directions))
    kept: list[np.ndarray] = []
    for k in np.argsort(-weight, kind="stable"):
        if all(directions[k] @ other < np.cos(np.radians(MERGE_DEG)) for other in kept):
            kept.append(directions[k])
    # Every face must find a direction that shows it.
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        if max(axis @ other for other in kept) < FACING_COSINE:
            kept.append(axis)
    return np.array(kept)


def find_adjacent_faces(faces: np.ndarray) -> np.ndarray:
    """(E, 2) pairs of faces that share an edge which no third face shares."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    same = (edges[1:] == edges[:-1]).all(1)
    single = same & ~np.r_[False, same[:-1]] & ~np.r_[same[1:], False]
    return np.stack([owner[:-1][single], owner[1:][single]], 1)


def find_overlapped_faces(chart: np.ndarray, flat: np.ndarray, height: np.ndarray) -> np.ndarray:
    """(F,) bool: faces that lie behind another face of their chart in the projection.

    Tested on a grid with cells of half an edge. Slivers may be missed; they cost a texel at most.
    """
    edge = np.median(np.linalg.norm(flat[:, 1] - flat[:, 0], axis=1))
    charts = int(chart.max()) + 1
    low = np.full((charts, 2), np.inf)
    high = np.full((charts, 2), -np.inf)
    for corner in range(3):
        np.minimum.at(low, chart, flat[:, corner])
        np.maximum.at(high, chart, flat[:, corner])
    cell = max(edge / 2.0, float(np.sqrt(np.prod(high - low, axis=1).sum() / GRID_CELLS)), 1e-30)
    size = np.ceil((high - low) / cell).astype(np.int64) + 2
    start = np.concatenate([[0], np.cumsum(size.prod(1))])
    order = np.argsort(-height, kind="stable")  # from front to back
    return _find_covered(order, chart, (flat - low[chart][:, None]) / cell, size[:, 0], start)


def _label_faces(normals: np.ndarray, areas: np.ndarray, directions: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    faces = len(normals)
    ones = np.ones(2 * len(pairs), np.float32)
    neighbours = coo_matrix((ones, (np.r_[pairs[:, 0], pairs[:, 1]], np.r_[pairs[:, 1], pairs[:, 0]])), (faces, faces)).tocsr()
    cosine = (normals @ directions.T).astype(np.float32)
    vote = np.clip(cosine, 0.0, 1.0) ** 4
    for _ in range(BROAD_SMOOTHING):
        vote = (neighbours @ vote + vote) / 4.0
    label = np.where(cosine > GRAZING_COSINE, vote, -1.0 + 0.1 * cosine).argmax(1)
    for _ in range(JOIN_ROUNDS):  # small charts join the neighbour with the longest common border that can show them
        chart = _label_connected(label, pairs)
        share = np.bincount(chart, areas) / areas.sum()
        small = share[chart] < SMALL_SHARE
        votes = np.zeros((faces, len(directions)), np.float32)
        for a, b in ((0, 1), (1, 0)):
            other = pairs[:, b]
            use = small[pairs[:, a]] & (share[chart[other]] > share[chart[pairs[:, a]]])
            np.add.at(votes, (pairs[use, a], label[other[use]]), 1.0)
        votes = np.where((cosine > GRAZING_COSINE) | (share[chart] < TINY_SHARE)[:, None], votes, 0.0)
        moves = small & (votes.max(1) > 0)
        if not moves.any():
            break
        label = np.where(moves, votes.argmax(1), label)
    return label


def _drop_tiny_groups(chosen: np.ndarray, pairs: np.ndarray, areas: np.ndarray) -> np.ndarray:
    group = _label_connected(chosen.astype(int), pairs)
    return chosen & (np.bincount(group, areas)[group] > TINY_SHARE * areas.sum())


def _label_connected(label: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    same = pairs[label[pairs[:, 0]] == label[pairs[:, 1]]]
    graph = coo_matrix((np.ones(len(same), bool), (same[:, 0], same[:, 1])), (len(label), len(label)))
    return connected_components(graph, directed=False)[1]


def _projection_axes(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    helper = np.where(np.abs(directions[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    right = np.cross(helper, directions)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return right, np.cross(directions, right)


@njit(cache=True)
def _find_covered(order: np.ndarray, chart: np.ndarray, flat: np.ndarray, width: np.ndarray, start: np.ndarray) -> np.ndarray:
    taken = np.zeros(start[-1], np.uint8)
    behind = np.zeros(len(chart), np.bool_)
    for f in order:
        ax, ay, bx, by, cx, cy = flat[f, 0, 0], flat[f, 0, 1], flat[f, 1, 0], flat[f, 1, 1], flat[f, 2, 0], flat[f, 2, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area <= 1e-12:
            behind[f] = area < -1e-9  # turned away
            continue
        hidden = False
        for write in range(2):
            if hidden:
                break
            for y in range(int(np.ceil(min(ay, by, cy) - 0.5)), int(np.floor(max(ay, by, cy) - 0.5)) + 1):
                for x in range(int(np.ceil(min(ax, bx, cx) - 0.5)), int(np.floor(max(ax, bx, cx) - 0.5)) + 1):
                    px, py = x + 0.5, y + 0.5
                    second = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / area
                    third = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / area
                    # the open triangle: neighbours share their edge and may not hide each other
                    if second > 1e-9 and third > 1e-9 and second + third < 1.0 - 1e-9:
                        place = start[chart[f]] + y * width[chart[f]] + x
                        if write:
                            taken[place] = 1
                        elif taken[place]:
                            hidden = True
        behind[f] = hidden
    return behind
