"""Choose the pairs of images to match: all pairs of a small set, and of a large one the pairs that look alike."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from zeroshop_steps.geometry.imaging.image_overlap import count_common_features, describe_view
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.scene.image_set import ImageSet, read_masks


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


def choose_alike_pairs(similar: np.ndarray, neighbours: int) -> list[tuple[int, int]]:
    """Pairs (i, j) with i < j of each image with those most like it, and those that connect all images along the likest pairs.

    For features that match only nearby views, unlike a network's (`choose_pairs`).

    Args:
        similar: (N, N) symmetric, 0 or more.
        neighbours: of each image.
    """
    alike = np.array(similar, float)
    np.fill_diagonal(alike, -np.inf)
    pairs = {
        (min(image, other), max(image, other))
        for image in range(len(alike))
        for other in np.argsort(-alike[image], kind="stable")[: min(neighbours, len(alike) - 1)].tolist()
    }
    distance = 1.0 / (1.0 + np.where(np.isfinite(alike), alike, 0.0))
    one, other = minimum_spanning_tree(distance).nonzero()
    pairs |= {(int(min(pair)), int(max(pair))) for pair in zip(one, other, strict=True)}
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


def choose_name_pairs(image_set: ImageSet, options: SiftOptions, object_only: bool = False) -> list[tuple[str, str]] | None:
    """The pairs of images to match, by their names, found from few features of small copies; None for all pairs."""
    if len(image_set.images) <= (options.all_pairs if image_set.film else options.all_photo_pairs):
        return None
    masks = read_masks(image_set) if object_only else {}
    descriptors = [describe_view(read_image(path), masks.get(path.name)) for path in image_set.images]
    chosen = choose_alike_pairs(count_common_features(descriptors), options.neighbours)
    return [(image_set.names[one], image_set.names[other]) for one, other in chosen]
