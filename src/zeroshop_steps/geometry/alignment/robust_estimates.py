"""How far measurements scatter, though some of them are wrong, and which agree."""

import numpy as np
from scipy.special import ndtri

MEDIAN_POINTS = 50  # points from which a median of ratios is taken
AGREEING_VIEWS = 2  # photos that must say the same: one alone may be wrong
AGREEING_DEVIATIONS = 3.0  # standard deviations within which two values agree; normal noise is beyond them in 0.3 % of cases


def robust_deviation(residuals: np.ndarray) -> float:
    """Standard deviation of (N,) residuals about 0, from the median of their absolute values: few that are far off hardly change it."""
    return float(np.median(np.abs(residuals)) / ndtri(0.75))
