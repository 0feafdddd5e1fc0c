"""Match SIFT descriptors of two images: each other's nearest neighbours, by far (Lowe, IJCV 2004, section 7.1)."""

import numpy as np

LARGEST_RATIO, LARGEST_ANGLE = 0.8, 0.7
"""Of the angle to the nearest descriptor to that to the second nearest, and of the angle itself, in radians: COLMAP's defaults."""
LENGTH = 512.0  # of COLMAP's descriptors, which are bytes
BLOCK_ROWS = 128  # of products that are formed at once, to stay in the cache


def match_descriptors(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(M, 2) uint32 numbers of the descriptors that are nearest to each other, nearer than the next by `LARGEST_RATIO` from either side.

    Products of bytes are whole numbers below 2^24, which float32 holds: the result depends on no order of sums.

    Args:
        first, second: (N, 128) and (K, 128) uint8 descriptors.
    """
    if not len(first) or not len(second):
        return np.zeros((0, 2), np.uint32)
    rows, columns = first.astype(np.float32), np.ascontiguousarray(second.T, np.float32)
    products = np.empty((BLOCK_ROWS, len(second)), np.float32)
    nearest, best, next_best = np.empty(len(first), np.int64), *np.empty((2, len(first)), np.float32)
    column_best = np.zeros(len(second), np.float32)
    for start in range(0, len(first), BLOCK_ROWS):
        block = slice(start, min(start + BLOCK_ROWS, len(first)))
        found = np.matmul(rows[block], columns, out=products[: block.stop - start])
        np.maximum(column_best, found.max(0), out=column_best)
        nearest[block], best[block], next_best[block] = _find_nearest(found)
    near = (best == column_best[nearest]) & (_angles(best) <= LARGEST_ANGLE) & _are_apart(best, next_best)
    one = np.flatnonzero(near)
    _, _, next_best = _find_nearest(np.ascontiguousarray(columns[:, nearest[one]].T) @ np.ascontiguousarray(rows.T))
    one = one[_are_apart(best[one], next_best)]
    return np.stack([one, nearest[one]], 1).astype(np.uint32)


def _find_nearest(products: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each row of (M, N) products the place of the largest, that one, and the second largest; changes `products`."""
    if not products.size:
        return np.zeros(len(products), np.int64), *np.zeros((2, len(products)), np.float32)
    nearest = products.argmax(1)
    best = np.take_along_axis(products, nearest[:, None], 1)[:, 0]
    np.put_along_axis(products, nearest[:, None], -1.0, 1)
    return nearest, best, products.max(1)


def _are_apart(best: np.ndarray, next_best: np.ndarray) -> np.ndarray:
    """Whether the nearest descriptor is much nearer than the second one, of their products."""
    return _angles(best) < LARGEST_RATIO * _angles(next_best)


def _angles(products: np.ndarray) -> np.ndarray:
    """Angles in radians between descriptors, of their products."""
    return np.arccos(np.clip(products / LENGTH**2, 0.0, 1.0))
