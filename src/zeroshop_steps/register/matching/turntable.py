"""Photos of an object on a turntable before a background that stands still: cameras would follow the background.

What stands still in the picture while the object turns has matches that do not move. In photos that were cropped around the object, all of
them move alike. Cameras that are found from the others see the object from all around, as if the camera had moved.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from zeroshop_steps.register.matching.verified_matches import verify_pairs
from zeroshop_steps.register.scene.database import LEAST_TIES, read_matches, read_places
from zeroshop_steps.register.scene.image_set import ImageSet

STATIONARY_PX = 4.0  # per 1000 px of the longer side: matches that move less stand still, and those whose moves differ by less move alike
STATIONARY_SHARE = 0.3
"""Share of the matches of the median pair that stand still: nearly none where the camera moves, most before a background with texture."""
STATIONARY_PAIR, STATIONARY_PAIRS, LEAST_PAIRS = 0.7, 0.02, 3
"""Before a background with little texture, only a few pairs match by it, but these contradict all others. A pair stands still if so many of
its matches do; a share of so many pairs, and at least three, are no photos that were taken twice from one place."""
APART_SHARE = 0.1
"""Share of the pairs with two motions. Of a still background behind a head that turns, in photos that were cropped, it was 0.29, of photos
around a thing at rest 0."""
APART_FIT = 0.5  # of the matches of one motion at most fit to the other one
MOST_TESTED = 120  # pairs that are looked at for two motions, evenly among all: each costs some hundredths of a second
TURNTABLE_REMEDY = "move the camera instead, hang a plain cloth behind the object, or give masks and take the scene video_segmented"
FITS, LEAST_FITTED = 4, 8  # rounds of fitting a similarity to what moves alike, and matches that hold it


@dataclass(frozen=True)
class StationaryMatches:
    """Matches that stand still.

    Attributes:
        share: of the verified matches of the median pair.
        pairs: share of the pairs whose verified matches stand still; 0 if they are fewer than `LEAST_PAIRS`.
        apart: share of the pairs in which many matches move alike, and many others differently; 0 if they are fewer than `LEAST_PAIRS`.
    """

    share: float
    pairs: float
    apart: float

    @property
    def are_background(self) -> bool:
        """Whether the background stood still while the object turned."""
        return self.share > STATIONARY_SHARE or self.pairs > STATIONARY_PAIRS or self.apart > APART_SHARE

    def describe(self) -> str:
        """What was found, for the user."""
        if self.share > STATIONARY_SHARE:
            how = f"{self.share:.0%} of what matches does not move"
        elif self.apart > APART_SHARE:
            how = f"in {self.apart:.0%} of the pairs, a part of what matches moves otherwise than the rest"
        else:
            how = f"in {self.pairs:.0%} of the pairs, what matches does not move"
        return f"the background stands still in the photos while the object turns ({how})"


def measure_stationary(database: Path, image_set: ImageSet, seed: int = 0) -> StationaryMatches:
    """How much stands still of the matches of all pairs of images of one size with enough matches. `seed` is of RANSAC."""
    if not (verified := _read_pairs(database, image_set, verified=True)):
        return StationaryMatches(0.0, 0.0, 0.0)
    still = np.array(
        [(np.linalg.norm(second - first, axis=1) < _limit_px(image_set, names)).mean() for names, first, second in verified], float
    )
    matched = [pair for pair in _read_pairs(database, image_set, verified=False) if len(pair[1]) >= 2 * LEAST_TIES]
    tested = matched[:: max(1, -(-len(matched) // MOST_TESTED))]
    two = [_has_two_motions(first, second, _limit_px(image_set, names), seed) for names, first, second in tested]
    return StationaryMatches(
        float(np.median(still)), _share(still > STATIONARY_PAIR), _share(np.array([one for one in two if one is not None]))
    )


def verify_without_stationary(database: Path, image_set: ImageSet, seed: int) -> None:
    """Verify the matches of all pairs anew, without those that stand still or move as one picture; changes the database in place."""
    kept, names = {}, []
    with pycolmap.Database.open(database) as opened:
        images = {image.image_id: image.name for image in opened.read_all_images()}
        points, sizes = read_places(opened), dict(zip(image_set.names, image_set.sizes_px, strict=True))
        for pair, matches in read_matches(opened, verified=False):
            first, second = pair
            names.append((images[first], images[second]))
            if len(matches) and sizes[images[first]] == sizes[images[second]]:
                one, other = points[first][matches[:, 0]], points[second][matches[:, 1]]
                limit_px = _limit_px(image_set, names[-1])
                matches = matches[~find_alike(one, other, limit_px) & (np.linalg.norm(other - one, axis=1) >= limit_px)]
            kept[pair] = matches
        opened.clear_two_view_geometries()
        opened.clear_matches()
        for (first, second), matches in kept.items():
            opened.write_matches(first, second, matches)
    # Pairs from other sides matched by the background alone, and fewer fit by chance.
    verify_pairs(database, names, seed, LEAST_TIES)


def find_alike(first: np.ndarray, second: np.ndarray, limit_px: float) -> np.ndarray:
    """(M,) bool: the most of (M, 2) matches, M > 0, that move as one picture does when it is shifted, and a little turned and scaled.

    They are those whose moves are densest, and what a similarity of them, fitted `FITS` times, misses by less than the limit.
    """
    moves = second - first
    tree = cKDTree(moves)
    densest = int(np.argmax(tree.query_ball_point(moves, limit_px, return_length=True)))
    middle = np.median(moves[tree.query_ball_point(moves[densest], limit_px)], axis=0)
    alike: np.ndarray = np.linalg.norm(moves - middle, axis=1) < limit_px
    for _ in range(FITS):
        if alike.sum() < LEAST_FITTED:
            break
        one, other = ((places - places[alike].mean(0)) @ [1, 1j] for places in (first, second))
        turned = (one[alike].conj() @ other[alike]) / max(float((abs(one[alike]) ** 2).sum()), 1e-12)  # least squares
        alike = abs(turned * one - other) < limit_px
    return alike


def _read_pairs(database: Path, image_set: ImageSet, verified: bool) -> list[tuple[tuple[str, str], np.ndarray, np.ndarray]]:
    """Names, and (M, 2) places of the matches in both images, of all pairs of images of one size with enough matches."""
    found = []
    sizes = dict(zip(image_set.names, image_set.sizes_px, strict=True))
    with pycolmap.Database.open(database) as opened:
        images = {image.image_id: image.name for image in opened.read_all_images()}
        points = read_places(opened)
        for (first, second), matches in read_matches(opened, verified):
            if len(matches) >= LEAST_TIES and sizes[images[first]] == sizes[images[second]]:
                found.append(((images[first], images[second]), points[first][matches[:, 0]], points[second][matches[:, 1]]))
    return found


def _has_two_motions(first: np.ndarray, second: np.ndarray, limit_px: float, seed: int) -> bool | None:
    """Whether the matches that move alike contradict the epipolar geometry of the others; None where one of both has too few.

    One camera before things at rest has one epipolar geometry for all matches. The one of few matches may be uncertain, so a common one
    must miss one of both, too.
    """
    alike = find_alike(first, second, limit_px)
    if min(alike.sum(), (~alike).sum()) < LEAST_TIES:
        return None
    options = pycolmap.RANSACOptions(max_error=limit_px, random_seed=seed)
    found = [pycolmap.estimate_fundamental_matrix(first[part], second[part], options) for part in (~alike, np.ones_like(alike))]
    if any(one is None for one in found) or found[0]["num_inliers"] < LEAST_TIES:
        return None
    rest = np.flatnonzero(~alike)[found[0]["inlier_mask"]]
    foreign = measure_sampson(found[0]["F"], first[alike], second[alike]) < limit_px
    common = np.asarray(found[1]["inlier_mask"])
    return bool(max(foreign.mean(), min(common[alike].mean(), common[rest].mean())) < APART_FIT)


def measure_sampson(
    fundamental: np.ndarray, first: np.ndarray, second: np.ndarray, slopes: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """(M,) Sampson distances of (M, 2) matches from an epipolar geometry (Hartley and Zisserman 2004, eq. 11.9).

    Args:
        slopes: of points that were moved, (M, 2, 2) of the first ones and the second ones: distances are those before.
    """
    one, other = (np.column_stack([points, np.ones(len(points))]) for points in (first, second))
    lines, back = one @ fundamental.T, other @ fundamental
    steepness = back[:, :2], lines[:, :2]
    if slopes:
        steepness = tuple(np.einsum("mji,mj->mi", slope, steep) for slope, steep in zip(slopes, steepness, strict=True))
    length: np.ndarray = np.sqrt((steepness[1] ** 2).sum(1) + (steepness[0] ** 2).sum(1))
    return np.abs((other * lines).sum(1)) / np.maximum(length, 1e-12)


def _limit_px(image_set: ImageSet, names: tuple[str, str]) -> float:
    return STATIONARY_PX * image_set.scales[names[0]]


def _share(found: np.ndarray) -> float:
    """The share that is true; 0 if that is fewer than `LEAST_PAIRS`."""
    return float(found.mean()) if found.sum() >= LEAST_PAIRS else 0.0
