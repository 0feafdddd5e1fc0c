"""Groups of images that show something in common: photos of another place or thing have no matches with the others."""

from pathlib import Path

import numpy as np
import pycolmap
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

LEAST_TIES = 30
"""Verified matches of a pair that tie two images: pairs that show nothing in common have up to 20 by chance."""


def find_components(database: Path) -> list[list[str]]:
    """Names of the images that verified matches of pairs tie together, directly or through others; the largest group first."""
    with pycolmap.Database.open(database) as opened:
        images = sorted(opened.read_all_images(), key=lambda image: image.name)
        row = {image.image_id: index for index, image in enumerate(images)}
        pairs = [
            [row[image_id] for image_id in pycolmap.pair_id_to_image_pair(pair_id)]
            for pair_id, geometry in zip(*opened.read_two_view_geometries(), strict=True)
            if len(geometry.inlier_matches) >= LEAST_TIES
        ]
    one, other = np.array(pairs, int).reshape(-1, 2).T
    labels = connected_components(coo_matrix((np.ones(len(one)), (one, other)), shape=(len(images),) * 2), directed=False)[1]
    groups = [[images[index].name for index in np.flatnonzero(labels == label)] for label in np.unique(labels)]
    return sorted(groups, key=lambda names: (-len(names), names))


def describe_components(groups: list[list[str]], shown: dict[str, str]) -> str:
    """The groups in words, by the names that the user knows."""
    several = [f"{len(names)} photos ({shown[names[0]]} to {shown[names[-1]]})" for names in groups if len(names) > 1]
    single = sum(len(names) == 1 for names in groups)
    return ", ".join(several + ([f"{single} that fit to no other"] if single else []))
