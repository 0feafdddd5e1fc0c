"""Choose the pairs of images to match: all pairs of a small set, and of a large one the pairs that look alike."""

from collections.abc import Callable
from itertools import combinations

import numpy as np


def choose_pairs(count: int, anchors: int, neighbours: int, similarities: Callable[[], np.ndarray]) -> list[tuple[int, int]]:
    """Pairs (i, j) with i < j that connect all images (Duisterhof et al., MASt3R-SfM, 3DV 2025, section 4.1).

    Anchors are images that are most unlike each other; each pair of them is matched, and each other image with its nearest anchor
    and with those images that are most like it.

    Args:
        count: of images.
        anchors: so many; up to that many images, all pairs are matched.
        neighbours: of each image.
        similarities: gives (count, count) similarities; called for more images than anchors alone.
    """
    if count <= anchors:
        return list(combinations(range(count), 2))
    similar = np.array(similarities(), float)
    np.fill_diagonal(similar, -np.inf)
    chosen = choose_farthest_apart(similar, anchors)
    pairs = set(combinations(sorted(chosen), 2))
    for image in range(count):
        alike = np.argsort(-similar[image], kind="stable")[:neighbours].tolist()
        if image not in chosen:
            alike.append(chosen[int(np.argmax(similar[image, chosen]))])
        pairs |= {(min(image, other), max(image, other)) for other in alike if other != image}
    return sorted(pairs)


def choose_farthest_apart(similar: np.ndarray, count: int) -> list[int]:
    """`count` images, each the one that is least like those before it; the first is most like all others."""
    finite = np.where(np.isfinite(similar), similar, 0.0)
    chosen = [int(np.argmax(finite.sum(1)))]
    while len(chosen) < count:
        nearest = similar[:, chosen].max(1)
        nearest[chosen] = np.inf
        chosen.append(int(np.argmin(nearest)))
    return chosen
