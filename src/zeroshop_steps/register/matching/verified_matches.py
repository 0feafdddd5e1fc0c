"""Match features of image pairs, and verify the matches by two views' geometry, in a COLMAP database.

Not by COLMAP's own matcher: pycolmap 4.2.1 holds a BLAS that is not safe to call from two threads at once, and in one of forty runs on two
threads pairs lost matches in silence.
"""

from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.matching.descriptor_matches import match_descriptors
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads

PROBES, LEAST_PROBES_MATCHED = 1000, 4
"""Features of the largest scales of each image that are matched first, and their matches: with fewer, a pair is not matched on (preemptive
matching: Wu 2013, section 4). A rendered bottle, the duck and the tissue box lost no pair with 30 verified matches of 157; half of the
pairs of the first two, which see other sides, were left."""


MAX_ERROR_PX = pycolmap.TwoViewGeometryOptions().ransac.max_error  # of a match from its epipolar geometry


def match_features(database: Path, options: SiftOptions, pairs: list[tuple[str, str]] | None = None) -> None:
    """Match image pairs and keep what one epipolar geometry (or homography) explains.

    Args:
        database: with the features of all images; pairs with matches keep these.
        options: see `SiftOptions`.
        pairs: names of the images of each pair; None for all pairs.
    """
    with pycolmap.Database.open(database) as opened:
        ids = {image.name: image.image_id for image in opened.read_all_images()}
        descriptors = {image_id: opened.read_descriptors(image_id).data for image_id in ids.values()}
        probes = {image_id: descriptors[image_id][_find_largest(opened.read_keypoints(image_id))] for image_id in ids.values()}
        wanted = [(ids[one], ids[other]) for one, other in (combinations(sorted(ids), 2) if pairs is None else pairs)]
        wanted = [pair for pair in wanted if not opened.exists_matches(*pair)]

    def match(pair: tuple[int, int]) -> np.ndarray:
        found = match_descriptors(probes[pair[0]], probes[pair[1]])
        if len(found) < LEAST_PROBES_MATCHED:
            return found[:0]  # they number the probes, not the features
        return match_descriptors(descriptors[pair[0]], descriptors[pair[1]])

    matches = map_in_threads(match, wanted, most_threads=options.threads)
    names = {image_id: name for name, image_id in ids.items()}
    with pycolmap.Database.open(database) as opened:
        for pair, found in zip(wanted, matches, strict=True):
            opened.write_matches(*pair, found)
    verify_pairs(database, [(names[one], names[other]) for one, other in wanted], options.seed)


def _find_largest(keypoints: np.ndarray) -> np.ndarray:
    """Numbers of the `PROBES` keypoints of the largest scales, of rows [x, y, a11, a12, a21, a22]."""
    areas = np.abs(keypoints[:, 2] * keypoints[:, 5] - keypoints[:, 3] * keypoints[:, 4])
    return np.argsort(-areas, kind="stable")[:PROBES]


def verify_pairs(database: Path, pairs: list[tuple[str, str]], seed: int, least_inliers: int | None = None) -> None:
    """Verify the matches of pairs, by the names of their images, which are written beside the database as COLMAP reads them."""
    path = Path(database).with_name("pairs.txt")
    path.write_text("".join(f"{first} {second}\n" for first, second in pairs))
    options = make_verification_options(seed)
    options.min_num_inliers = least_inliers or options.min_num_inliers
    if pairs:
        pycolmap.verify_matches(database, path, options)


def make_verification_options(seed: int) -> pycolmap.TwoViewGeometryOptions:
    """Options of the geometric verification, with a fixed seed."""
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    return verification
