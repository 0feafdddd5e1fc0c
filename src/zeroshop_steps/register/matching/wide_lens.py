"""Tell wide lenses from ordinary ones by the matches of image pairs, before anything is mapped: action cameras, 0.5x lenses, fisheyes.

COLMAP verifies matches of unknown lenses by a fundamental matrix, which no strong distortion obeys: the mapper then begins with what is
left, and its one radial coefficient cannot follow the lens to the rim. Both lens models are compared where neither poses nor focal length
are known. Points are moved to where a pinhole would see them, by one parameter of either model, and an epipolar geometry is fitted:

- radial: r_d = r_u (1 + k r_u^2), COLMAP's SIMPLE_RADIAL;
- equidistant: r_d = f atan(r_u / f), the ideal fisheye (Kannala and Brandt 2006), COLMAP's fisheyes without coefficients.

With as many parameters, the larger likelihood decides; what fisheyes have more of them counts by the Bayesian information criterion
(Schwarz 1978), and must without the pair that gains most, for RANSAC may fail on one. Radii are shares of the longer side of the image.
An ordinary lens is told by two fits to a part of the matches.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.register.matching.turntable import STATIONARY_PX, measure_sampson
from zeroshop_steps.register.matching.verified_matches import MAX_ERROR_PX, verify_pairs
from zeroshop_steps.register.scene.database import read_matches, read_places
from zeroshop_steps.register.scene.image_set import REFERENCE_PX

MODELS = (("RADIAL_FISHEYE", 1, 2), ("OPENCV_FISHEYE", 2, 4))  # with focal lengths and coefficients; the simplest first
WIDE_LENS_REMEDY = (
    "Besides, the photos were taken through a wide lens (an action camera, a 0.5x lens or a fisheye), which is harder: use the 1x lens, or"
    " the camera's linear mode"
)
RADIAL = (-0.8, -0.6, -0.45, -0.3, -0.2, -0.1)
EQUIDISTANT = (0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.85)
SCREENED = 1.0  # an equidistant lens that shows 57 degrees along the longer side: wide lenses show more, and bend more
FOCAL_SHARES = tuple(np.geomspace(0.25, 2.0, 13))  # focal lengths that are tried with the distortion that was found
MOST_FOCAL_SHARE = float(np.sqrt(1.5))
"""Of the focal length of the ideal lens that bends as much: of an orthographic lens, r = f sin(angle), and none bends more."""
PAIRS, MATCHES, LEAST_MATCHES = 8, 300, 50  # of a lens that are looked at, those with the most matches, and so many of each
MOST_SIGMA = 4.0  # an outlier counts as an error of so many standard deviations
LEAST_SIGMA = 0.00025  # of features; of the longer side: no better ones were seen
LARGEST_TURN = 1.4  # rad: an equidistant lens is followed up to here, as a pinhole sees no farther than 90 degrees
FARTHEST = float(np.tan(LARGEST_TURN))  # radius to which a point is moved that a model cannot explain


@dataclass(frozen=True)
class Distortion:
    """One parameter of a lens's distortion: of SIMPLE_RADIAL its coefficient, else the focal length of an equidistant lens."""

    equidistant: bool
    parameter: float

    def undo(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N, 2) undistorted points of (N, 2) points about the principal point, their (N, 2, 2) slopes, and (N,) whether they exist."""
        radii = np.maximum(np.linalg.norm(points, axis=1), 1e-12)
        moved, slope, known = self._undo_equidistant(radii) if self.equidistant else self._undo_radial(radii)
        outwards = points / radii[:, None]
        along = outwards[:, :, None] * outwards[:, None, :]
        derivative = slope[:, None, None] * along + (moved / radii)[:, None, None] * (np.eye(2) - along)
        return outwards * moved[:, None], derivative, known

    def _undo_equidistant(self, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        turn = np.minimum(radii / self.parameter, LARGEST_TURN)
        return self.parameter * np.tan(turn), 1 / np.cos(turn) ** 2, radii / self.parameter < LARGEST_TURN

    def _undo_radial(self, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """By Newton's method; beyond the radius from which on the model folds, there is no solution."""
        moved = radii.copy()
        for _ in range(12):
            slope = np.maximum(1 + 3 * self.parameter * moved**2, 0.05)
            moved = np.clip(moved - (moved * (1 + self.parameter * moved**2) - radii) / slope, 0.0, FARTHEST)
        slope = 1 + 3 * self.parameter * moved**2
        known = (np.abs(moved * (1 + self.parameter * moved**2) - radii) < 1e-6) & (slope > 0.05)
        return moved, 1 / np.maximum(slope, 0.05), known


@dataclass(frozen=True)
class WideLens:
    """A lens that the matches show to be wide.

    Attributes:
        camera: RADIAL_FISHEYE, or OPENCV_FISHEYE where that is not rich enough, to start from.
        reach_px: distance from the middle of the picture to which it is followed: a pinhole sees nothing of what lies beyond 90 degrees.
    """

    camera: pycolmap.Camera
    reach_px: float


Pair = tuple[np.ndarray, np.ndarray]
"""(M, 2) places of matches in two images of one lens, about the principal point, as shares of the longer side."""


def find_wide_lenses(database: Path, seed: int) -> dict[int, WideLens]:
    """{camera id: lens} of the lenses that the matches show to be wide; mostly none.

    A camera that was held upright for a few photos has another lens there, which few matches tell of: then it is as in the others.

    Args:
        database: with matches of image pairs.
        seed: of RANSAC.
    """
    with pycolmap.Database.open(database) as opened:
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        pairs = _read_pairs(opened, cameras)
    chosen = {camera_id: choose_distortion(matches, seed) for camera_id, matches in pairs.items() if matches}
    like = {camera_id: camera_id if camera_id in chosen else _find_turned(camera, cameras, chosen) for camera_id, camera in cameras.items()}
    return {
        camera_id: _make_lens(cameras[camera_id], chosen[known], pairs[known], seed)
        for camera_id, known in like.items()
        if known is not None and chosen[known].equidistant
    }


def choose_distortion(pairs: list[Pair], seed: int = 0) -> Distortion:
    """The model and parameter that explain the matches best; an undistorted radial one where a wide lens explains them worse."""
    tried = [Distortion(False, 0.0), Distortion(True, SCREENED)]
    errors = [_measure_errors(pairs, one, None, seed) for one in tried]
    plain, wide = _find_costs(errors, pairs)
    if plain.sum() <= wide.sum():
        return tried[0]
    tried += [Distortion(False, k) for k in RADIAL] + [Distortion(True, f) for f in EQUIDISTANT]
    errors += [_measure_errors(pairs, one, None, seed) for one in tried[len(errors) :]]
    costs = _find_costs(errors, pairs)
    best = int(np.argmin(costs.sum(1)))
    radial = min((cost for one, cost in zip(tried, costs, strict=True) if not one.equidistant), key=np.sum)
    return tried[best] if _is_better(costs[best], radial, MODELS[-1][2] - 1, errors[best]) else tried[0]


def set_lenses(database: Path, lenses: dict[int, WideLens], seed: int) -> None:
    """Give lenses of a database other models, and verify the matches of all pairs anew by them.

    Matches that stand still are left out, as the rim of a fisheye's picture lies at one place of all photos, and so are those that lie
    beyond the reach of the lens.
    """
    with pycolmap.Database.open(database) as opened:
        for lens in lenses.values():
            opened.update_camera(lens.camera)
        images = {image.image_id: image for image in opened.read_all_images()}
        points, pairs = read_places(opened), read_matches(opened, verified=False)
        opened.clear_two_view_geometries()
        for (first, second), found in pairs:
            kept = _find_usable([lenses.get(images[image].camera_id) for image in (first, second)], points[first], points[second], found)
            if not kept.all():
                opened.delete_matches(first, second)
                opened.write_matches(first, second, found[kept])
    verify_pairs(database, [(images[first].name, images[second].name) for (first, second), _ in pairs], seed)


def _find_usable(lenses: list[WideLens | None], first: np.ndarray, second: np.ndarray, matches: np.ndarray) -> np.ndarray:
    """(M,) bool: which of (M, 2) matches lie within the reach of the lenses and do not stand still, by the (K, 2) places in each image."""
    usable = np.ones(len(matches), bool)
    if not len(matches):
        return usable
    places = first[matches[:, 0]], second[matches[:, 1]]
    for lens, seen in zip(lenses, places, strict=True):
        if lens is not None:
            middle = np.array([lens.camera.width, lens.camera.height]) / 2
            usable &= np.linalg.norm(seen - middle, axis=1) < lens.reach_px
    if lenses[0] is not None and lenses[0] is lenses[1]:
        still_px = STATIONARY_PX / REFERENCE_PX * max(lenses[0].camera.width, lenses[0].camera.height)
        usable &= np.linalg.norm(places[0] - places[1], axis=1) > still_px
    return usable


def _find_costs(errors: list[np.ndarray], pairs: list[Pair]) -> np.ndarray:
    """(T, P) negative logarithms of the likelihood of T (M,) errors in each pair: a Gaussian with outliers, of one width for all."""
    sigma = max(LEAST_SIGMA, min(float(np.median(one)) for one in errors) / 0.6745)
    starts = np.cumsum([0, *(len(first) for first, _ in pairs)])[:-1]
    return np.array([np.add.reduceat(np.minimum((one / sigma) ** 2, MOST_SIGMA**2) / 2, starts) for one in errors])


def _is_better(costs: np.ndarray, others: np.ndarray, parameters: int, errors: np.ndarray) -> bool:
    """Whether (P,) costs are lower than others by what so many more parameters must gain (BIC), whichever pair is left out."""
    gains = others - costs
    return bool(gains.sum() - gains.max() > parameters / 2 * np.log(len(errors)))


def _measure_errors(pairs: Iterable[Pair], distortion: Distortion, focal: float | None, seed: int) -> np.ndarray:
    """(M,) Sampson distances of all matches in the images as taken, from each pair's epipolar geometry of the undistorted points.

    Args:
        focal: of the pinhole that sees the undistorted points, for an essential matrix; None for a fundamental one.
    """
    options = pycolmap.RANSACOptions(max_error=MAX_ERROR_PX, random_seed=seed, min_num_trials=50, max_num_trials=200)
    errors = [np.zeros(0)]
    for places in pairs:
        (first, slope_first, known_first), (second, slope_second, known_second) = (distortion.undo(points) for points in places)
        known = known_first & known_second
        error = np.full(len(first), np.inf)
        fundamental = _fit_epipolar_geometry(first[known], second[known], focal, options) if known.sum() >= LEAST_MATCHES else None
        if fundamental is not None:
            error[known] = measure_sampson(fundamental, first[known], second[known], (slope_first[known], slope_second[known]))
        errors.append(error)
    return np.concatenate(errors)


def _fit_epipolar_geometry(
    first: np.ndarray, second: np.ndarray, focal: float | None, options: pycolmap.RANSACOptions
) -> np.ndarray | None:
    """(3, 3) fundamental matrix of (M, 2) undistorted matches; None where none was found. COLMAP wants about 1000 px."""
    enlarge = np.diag([1000.0, 1000.0, 1.0])
    if focal is None:
        found = pycolmap.estimate_fundamental_matrix(1000 * first, 1000 * second, options)
        return enlarge @ found["F"] @ enlarge if found else None
    pinhole = pycolmap.Camera(model="SIMPLE_PINHOLE", width=1000, height=1000, params=[1000 * focal, 0.0, 0.0])
    found = pycolmap.estimate_essential_matrix(1000 * first, 1000 * second, pinhole, pinhole, options)
    shrink = np.diag([1 / focal, 1 / focal, 1.0])
    return shrink @ found["E"] @ shrink if found else None


def _make_lens(camera: pycolmap.Camera, distortion: Distortion, pairs: list[Pair], seed: int) -> WideLens:
    """The simplest fisheye with the distortion that was found, and the focal length that is known or that the matches ask for.

    A lens is rich enough that follows the distortion as closely as features lie that are no outliers.
    """
    side_px = max(camera.width, camera.height)
    focal = camera.mean_focal_length() / side_px if camera.has_prior_focal_length else _find_focal(distortion, pairs, seed)
    matched = max(float(np.linalg.norm(points, axis=1).max()) for pair in pairs for points in pair)
    reach = np.linspace(0.0, 1.0, 100)[1:] * min(matched, LARGEST_TURN * distortion.parameter)
    turn = np.arctan(distortion.parameter * np.tan(reach / distortion.parameter) / focal)
    rest = reach / focal - turn
    powers = [turn[:, None] ** (3 + 2 * np.arange(count)) for _, _, count in MODELS]
    fits = [np.linalg.lstsq(power, rest, rcond=None)[0] for power in powers]
    errors = [focal * float(np.abs(power @ fit - rest).max()) for power, fit in zip(powers, fits, strict=True)]
    simplest = next((number for number, error in enumerate(errors) if error < MOST_SIGMA * LEAST_SIGMA), len(MODELS) - 1)
    model, focals, _ = MODELS[simplest]
    params = [*[focal * side_px] * focals, camera.width / 2, camera.height / 2, *fits[simplest]]
    fields = {"width": camera.width, "height": camera.height, "params": params, "has_prior_focal_length": True}
    return WideLens(
        pycolmap.Camera({"model": model, "camera_id": camera.camera_id, **fields}), LARGEST_TURN * distortion.parameter * side_px
    )


def _find_focal(distortion: Distortion, pairs: list[Pair], seed: int) -> float:
    """The focal length, as a share of the longer side, with which matches obey essential matrices best.

    Pairs that see a plane leave much open: that of the ideal lens stays where no other one is better by what one more parameter gains.
    """
    shares = [distortion.parameter, *(share for share in FOCAL_SHARES if share <= MOST_FOCAL_SHARE * distortion.parameter)]
    errors = [_measure_errors(pairs, distortion, share, seed) for share in shares]
    costs = _find_costs(errors, pairs)
    best = int(np.argmin(costs.sum(1)))
    return shares[best] if _is_better(costs[best], costs[0], 1, errors[best]) else distortion.parameter


def _find_turned(camera: pycolmap.Camera, cameras: dict[int, pycolmap.Camera], known: Iterable[int]) -> int | None:
    """Which of the known lenses has a camera's sides the other way round; None where none or several have."""
    turned = [other for other in known if (cameras[other].height, cameras[other].width) == (camera.width, camera.height)]
    return turned[0] if len(turned) == 1 else None


def _read_pairs(opened: pycolmap.Database, cameras: dict[int, pycolmap.Camera]) -> dict[int, list[Pair]]:
    """{camera id: its pairs of images with the most matches}, of each evenly so many matches."""
    owner = {image.image_id: image.camera_id for image in opened.read_all_images()}
    chosen: dict[int, list[Pair]] = {}
    for (first, second), matched in sorted(read_matches(opened, verified=False), key=lambda pair: (-len(pair[1]), pair[0])):
        pairs = chosen.setdefault(owner[first], [])
        if owner[first] != owner[second] or len(pairs) == PAIRS or len(matched) < LEAST_MATCHES:
            continue
        camera = cameras[owner[first]]
        matches = matched[:: -(-len(matched) // MATCHES)]
        points = (opened.read_keypoints(image)[rows, :2] for image, rows in zip((first, second), matches.T, strict=True))
        side_px = max(camera.width, camera.height)
        one, other = ((places - np.array([camera.width, camera.height]) / 2) / side_px for places in points)
        pairs.append((one, other))
    return chosen
