"""Factors that give photos equal exposure and white balance, from the colours of points that they share.

A point has about the same colour in all photos. What one photo shows brighter or bluer than the others at most of its points is the
camera's doing, so each photo gets a factor per channel in linear light (gain compensation as for panoramas, Brown and Lowe 2007).
Highlights move few points of a photo, and what a surface mirrors moves dark points most; so colours count less the farther they are
off, and the less the darker they are.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from zeroshop_steps.segment.photometry.shared_colors import SharedColors

DARK = 0.03  # linear light below which reflections and noise outweigh a point's own colour
ROUNDS = 20  # of least squares, with weights from the residuals before
OUTLIER_DEVIATIONS = 2.0  # colours that are off by so many standard deviations count half
PRIOR_DEVIATION = 0.3  # of a gain's logarithm, about what cameras do: a photo that shares little stays as it is
LEAST_GAIN = 0.07
"""Logarithm of a gain up to which photos count as equal, a tenth of a stop: shading that depends on the view makes up nearly as much."""
LEAST_DEVIATIONS = 4.0  # of its standard deviation that a gain must have, too
GAIN_RANGE = (0.4, 2.5)  # beyond, it is not the exposure but another light


@dataclass(frozen=True)
class Gains:
    """What makes photos equal.

    Attributes:
        log_gains: (V, 3) natural logarithms of the factors in linear light; the median photo keeps its colours.
        deviations: (V, 3) their standard deviations, by the jackknife over the scene's parts: shading moves neighbouring points alike,
            so that the scatter of single points would make them too small.
        significant: whether any photo differs from the others by more than shading and noise explain.
    """

    log_gains: np.ndarray
    deviations: np.ndarray
    significant: bool


def estimate_gains(seen: SharedColors, photos: int) -> Gains:
    """Factors for `photos` photos: robust least squares over logarithms of colours, in which the points' own colours are eliminated.

    The weights are Cauchy's, of the residuals of all channels together: a highlight moves all of them.
    """
    use = ~seen.clipped & (seen.light.min(1) > 0)
    shared = use & (np.bincount(seen.point[use], minlength=seen.point.max(initial=0) + 1)[seen.point] > 1)
    if not shared.any():
        return Gains(np.zeros((photos, 3)), np.full((photos, 3), PRIOR_DEVIATION), False)
    photo, value, part = seen.photo[shared], np.log(seen.light[shared]), seen.part[shared]
    point = np.unique(seen.point[shared], return_inverse=True)[1]
    trust = 1.0 / (1.0 + (DARK / seen.light[shared].min(1)) ** 2)
    weight, spread = trust, 0.1
    for _ in range(ROUNDS):
        exposure = _solve(photo, point, value, weight, spread, photos)
        rest = value - exposure[photo]
        off = np.sqrt(((rest - _mean_by(point, weight, rest)[point]) ** 2).mean(1))
        spread = max(1.4826 * float(np.median(off)), 1e-3)
        weight = trust / (1.0 + (off / (OUTLIER_DEVIATIONS * spread)) ** 2)
    # The jackknife needs no new weights: whole points are left out, and a weight of almost nothing leaves them out.
    present = np.unique(part)
    without = np.stack([_solve(photo, point, value, weight * np.where(part == one, 1e-9, 1.0), spread, photos) for one in present])
    deviations = np.sqrt((len(present) - 1) * without.var(0)) if len(present) > 1 else np.full((photos, 3), PRIOR_DEVIATION)
    log_gains = np.clip(np.median(exposure, 0) - exposure, *np.log(GAIN_RANGE))
    differs = np.abs(log_gains) > np.maximum(LEAST_GAIN, LEAST_DEVIATIONS * deviations)
    return Gains(log_gains, deviations, bool(differs.any()))


def _solve(photo: np.ndarray, point: np.ndarray, value: np.ndarray, weight: np.ndarray, spread: float, photos: int) -> np.ndarray:
    """(V, 3) logarithms of the photos' exposures, their mean 0, for fixed weights."""
    weights = csr_matrix((weight, (photo, point)), shape=(photos, point.max() + 1))
    per_point = np.asarray(weights.sum(0)).ravel()
    normal = np.diag(np.asarray(weights.sum(1)).ravel()) - (weights.multiply(1.0 / per_point) @ weights.T).toarray()
    right = np.stack([np.bincount(photo, weight * channel, photos) for channel in value.T], 1) - weights @ _mean_by(point, weight, value)
    exposure = np.linalg.solve(normal / spread**2 + np.eye(photos) / PRIOR_DEVIATION**2, right / spread**2)
    return exposure - exposure.mean(0)


def _mean_by(point: np.ndarray, weight: np.ndarray, value: np.ndarray) -> np.ndarray:
    """(P, 3) weighted means of the (K, 3) values of each point."""
    return np.stack([np.bincount(point, weight * channel) for channel in value.T], 1) / np.bincount(point, weight)[:, None]
