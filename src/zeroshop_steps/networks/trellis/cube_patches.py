"""How a surface passes through a cube whose corners are inside or outside: in patches, each with a vertex of its own.

Where the surface crosses the cube's edges, a curve on the cube's faces connects the crossings; each closed curve bounds a patch (dual
marching cubes, Nielson 2004). A face whose corners alternate can be connected in two ways. The usual one keeps its inside corners
apart; the other is taken where two neighbouring cubes would else join both of the face's curves in one patch each, which would make
an edge of four faces. Instead of a table that somebody typed, the patches follow from these sentences.
"""

import functools

import numpy as np

CORNERS = np.array([[index >> axis & 1 for axis in range(3)] for index in range(8)])
"""(8, 3) corner i has coordinate bit k of i along axis k."""
EDGES = np.array([[0, 1], [1, 5], [4, 5], [0, 4], [2, 3], [3, 7], [6, 7], [2, 6], [2, 0], [3, 1], [7, 5], [6, 4]])
"""(12, 2) corners of the edges, in the order in which TRELLIS's mesh decoder was trained to weigh them."""


def _edge_between(first: int, second: int) -> int:
    return next(index for index, edge in enumerate(EDGES) if set(edge) == {first, second})


def _face_corners(axis: int, side: int) -> list[int]:
    """The four corners of a face, around it."""
    first, second = (1 << other for other in range(3) if other != axis)
    base = side << axis
    return [base, base | first, base | first | second, base | second]


FACES = [(_face_corners(axis, side)) for axis in range(3) for side in range(2)]
"""Corners around each face; face 2 axis + side."""
FACE_EDGES = [[_edge_between(corners[k], corners[(k + 1) % 4]) for k in range(4)] for corners in FACES]
"""Edge k of a face runs from its corner k to the next."""


@functools.cache
def find_patches(inside: int, flipped: int) -> tuple[int, ...]:
    """For each of the 12 edges, the patch that crosses it, or -1.

    Args:
        inside: bit i says that corner i is inside.
        flipped: bit f says that face f is connected in the other way, where there are two.
    """
    joined = {edge: edge for edge in range(12) if (inside >> EDGES[edge][0] ^ inside >> EDGES[edge][1]) & 1}

    def root(edge: int) -> int:
        while joined[edge] != edge:
            edge = joined[edge]
        return edge

    for face, edges in enumerate(FACE_EDGES):
        crossing = [edge for edge in edges if edge in joined]
        if len(crossing) == 2:
            joined[root(crossing[0])] = root(crossing[1])
        elif len(crossing) == 4:
            # Edges 3 and 0 meet at corner 0: they belong together where that corner is inside, or outside and flipped.
            around_first = (inside >> FACES[face][0] & 1) ^ (flipped >> face & 1)
            pairs = ((3, 0), (1, 2)) if around_first else ((0, 1), (2, 3))
            for a, b in pairs:
                joined[root(edges[a])] = root(edges[b])
    roots = sorted({root(edge) for edge in joined})
    return tuple(roots.index(root(edge)) if edge in joined else -1 for edge in range(12))


def patches_of_cubes(inside: np.ndarray, flipped: np.ndarray) -> np.ndarray:
    """(C, 12) int8 patches of the edges of cubes with these (C,) corner and face bits."""
    kinds, index = np.unique(inside.astype(np.int64) << 6 | flipped.astype(np.int64), return_inverse=True)
    table = np.array([find_patches(int(kind) >> 6, int(kind) & 63) for kind in kinds], np.int8).reshape(-1, 12)
    return table[index.reshape(-1)]


def four_edges_in_one_patch(patches: np.ndarray, face: int) -> np.ndarray:
    """(C,) bool: all four edges of a face are crossed, by one patch; `patches` are those of `patches_of_cubes`."""
    around = patches[:, FACE_EDGES[face]]
    return (around[:, 0] >= 0) & (around == around[:, :1]).all(1)
