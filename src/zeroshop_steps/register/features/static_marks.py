"""Marks that stand at one place of all photos: a watermark, a timestamp, dirt on the lens. Their features tie photos that share nothing.

A mark is what looks alike at the same place in most photos of one size, although the rest of the picture changes. Pairs whose pictures
stand still as a whole tell nothing of it: frames of a camera at rest, or an object that turns before a still background, which
`matching.turntable` handles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from zeroshop_steps.register.scene.database import replace_features
from zeroshop_steps.register.scene.image_set import REFERENCE_PX, ImageSet, find_cells

PLACE_PX = 2.0  # and so many per 1000 px of larger pictures: what lies around a mark shifts its features by a pixel or two
LEAST_COSINE = float(np.cos(0.7))  # of descriptors that look alike: the largest angle at which COLMAP matches them
MOST_CELLS = 0.3
"""Share of the cells with features in which something stands still, beyond which the whole picture counts as still: a line of text takes up
to 8 of 64 cells, and a plain picture has features in less than half of them."""
LEAST_SHARE, LEAST_AGAIN = 1 / 3, 3
"""Of the photos against which a picture changes, a feature of a mark is found again in so large a share, and in so many: what lies around a
letter changes how SIFT finds it. By chance, a feature is like one at its place in one photo now and then, hardly in three.
Among five photos, the fewest that are looked at, that is three of four others: single features, and faint marks, then stay."""
LEAST_PARTNERS = 4  # photos against which a picture changes: among fewer, one pair that is alike by chance counts too much
MOST_IMAGES = 0.5  # of the photos: what stands still in fewer of them is no mark of the camera
LEAST_FEATURES = 8  # of all marks, in the median photo: with fewer, a pair does not reach the 15 matches that verify it
REACH_SHARE = 1 / 40  # of the longer side, around each place: the height of a line of text, whose digits may change
LINK_SHARE = 1 / 15  # of the longer side: what lies nearer to each other is one mark, as words of a line
MOST_COMPARED = 16  # photos of one size, evenly among all: 120 pairs take a third of a second
PARTS = (
    ("upper left corner", "upper edge", "upper right corner"),
    ("left edge", "middle", "right edge"),
    ("lower left corner", "lower edge", "lower right corner"),
)


@dataclass(frozen=True)
class StaticMark:
    """What stands still in one part of the photos of one size.

    Attributes:
        where: the part, in words.
        images, compared: photos in which it was found, and those in which it was looked for.
    """

    where: str
    images: int
    compared: int


@dataclass(frozen=True)
class StaticMarks:
    """All marks of a set of images.

    Attributes:
        found: what the user is told.
        places_px: {(width, height) of images: (P, 2) places in them of features that stand still}.
    """

    found: tuple[StaticMark, ...] = ()
    places_px: dict[tuple[int, int], np.ndarray] = field(default_factory=dict)

    def leave_out(self, database: Path, image_set: ImageSet) -> None:
        """Delete the features on the marks; images with such features must have no matches yet. Changes the database in place."""
        if not self.places_px:
            return
        kept = {}
        with pycolmap.Database.open(database) as opened:
            images = {image.name: image.image_id for image in opened.read_all_images()}
            for name, size_px in zip(image_set.names, image_set.sizes_px, strict=True):
                keypoints = opened.read_keypoints(images[name])
                if size_px not in self.places_px or not len(keypoints):
                    continue
                distances_px = cKDTree(self.places_px[size_px]).query(keypoints[:, :2])[0]
                clear = distances_px > REACH_SHARE * max(size_px)
                if not clear.all():
                    descriptors = opened.read_descriptors(images[name])
                    kept[images[name]] = keypoints[clear], pycolmap.FeatureDescriptors(descriptors.type, descriptors.data[clear])
            if kept:
                replace_features(opened, kept)


def find_static_marks(database: Path, image_set: ImageSet) -> StaticMarks:
    """The marks in images whose features were just found, by SIFT."""
    found: list[StaticMark] = []
    places_px = {}
    with pycolmap.Database.open(database) as opened:
        images = {image.name: image.image_id for image in opened.read_all_images()}
        for size_px in sorted(set(image_set.sizes_px)):
            names = [name for name, own in zip(image_set.names, image_set.sizes_px, strict=True) if own == size_px]
            compared = [images[name] for name in names[:: -(-len(names) // MOST_COMPARED)]]
            if len(compared) <= LEAST_PARTNERS:
                continue
            features = [(opened.read_keypoints(one)[:, :2].astype(float), opened.read_descriptors(one).data) for one in compared]
            still = _find_still(features, size_px)
            places = np.concatenate([points[mask] for (points, _), mask in zip(features, still, strict=True)])
            owners = np.repeat(np.arange(len(still)), [mask.sum() for mask in still])
            marks = _find_clusters(places, owners, size_px, MOST_IMAGES * len(still))
            on_marks = np.concatenate([np.zeros(0, int), *marks])
            if np.median(np.bincount(owners[on_marks], minlength=len(still))) >= LEAST_FEATURES:
                places_px[size_px] = places[on_marks]
                found += _describe([places[mark] for mark in marks], [owners[mark] for mark in marks], size_px, len(still))
    return StaticMarks(tuple(found), places_px)


def describe_marks(marks: Sequence[StaticMark]) -> list[str]:
    """The marks in words, for the user."""
    return [
        f"a mark {'at' if mark.where.endswith('edge') else 'in'} the {mark.where} stands still"
        f" in {mark.images} of {mark.compared} photos that were compared"
        " (a timestamp, a watermark or dirt on the lens): features on it are left out; next time, switch it off or wipe the lens"
        for mark in marks
    ]


def _find_still(features: list[tuple[np.ndarray, np.ndarray]], size_px: tuple[int, int]) -> list[np.ndarray]:
    """(K,) bool for each image of K features: those found alike at the same place in enough pictures that are else different.

    Args:
        features: (K, 2) places and (K, 128) descriptors of each image.
        size_px: (width, height) of all.
    """
    trees = [cKDTree(points) for points, _ in features]
    cells = [find_cells(points, size_px) for points, _ in features]
    radius_px = PLACE_PX * max(1.0, max(size_px) / REFERENCE_PX)
    again = [np.zeros(len(points), int) for points, _ in features]  # in so many pictures
    partners = np.zeros(len(features), int)
    for pair in combinations(range(len(features)), 2):
        if not all(len(cells[image]) for image in pair):
            continue
        near = trees[pair[0]].sparse_distance_matrix(trees[pair[1]], radius_px, output_type="ndarray")
        places = np.stack([near["i"], near["j"]])
        one, other = (features[image][1][rows].astype(np.float32) for image, rows in zip(pair, places, strict=True))
        lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
        alike = [np.unique(rows) for rows in places[:, (one * other).sum(1) >= LEAST_COSINE * np.maximum(lengths, 1e-12)]]
        share = max(len(np.unique(cells[image][rows])) / len(np.unique(cells[image])) for image, rows in zip(pair, alike, strict=True))
        if share <= MOST_CELLS:
            for image, rows in zip(pair, alike, strict=True):
                partners[image] += 1
                again[image][rows] += 1
    least = np.maximum(LEAST_SHARE * partners, LEAST_AGAIN)
    return [(count >= enough) & (other >= LEAST_PARTNERS) for count, enough, other in zip(again, least, partners, strict=True)]


def _find_clusters(places: np.ndarray, owners: np.ndarray, size_px: tuple[int, int], least_images: float) -> list[np.ndarray]:
    """Numbers of the (P, 2) places in each cluster that has some in enough images, by the (P,) owners; the largest cluster first."""
    one, other = cKDTree(places).query_pairs(LINK_SHARE * max(size_px), output_type="ndarray").T
    labels = connected_components(coo_matrix((np.ones(len(one)), (one, other)), shape=(len(places),) * 2), directed=False)[1]
    clusters = [np.flatnonzero(labels == label) for label in np.argsort(-np.bincount(labels), kind="stable")]
    return [cluster for cluster in clusters if len(np.unique(owners[cluster])) >= least_images]


def _describe(places: list[np.ndarray], owners: list[np.ndarray], size_px: tuple[int, int], compared: int) -> list[StaticMark]:
    """The marks of images of one size, by the part of the picture in which the middle of each lies."""
    inside: dict[str, list[np.ndarray]] = {}
    for points, images in zip(places, owners, strict=True):
        column, row = np.clip(points.mean(0) / size_px * 3, 0, 2).astype(int)
        inside.setdefault(PARTS[row][column], []).append(images)
    return [StaticMark(where, len(np.unique(np.concatenate(images))), compared) for where, images in inside.items()]
