"""How probable it is that an estimated pose is right, from what can be seen without knowing the truth."""

import numpy as np

SAME_DIAMETERS = 0.1
"""A pose is right where no point of the model is off by more (MSSD), symmetries taken into account."""
WEIGHTS = np.array([-4.0, 7.0, 6.0, 0.0, 1.0])


def features(explained: float, margin: float, points: int, detection: float) -> np.ndarray:
    """(5,) what the probability is made of; the last is the detection's own confidence."""
    return np.array([1.0, explained, min(margin, 0.2) / 0.2, np.log10(max(points, 1)) - 3.0, detection])


def confidence(explained: float, margin: float, points: int, detection: float) -> float:
    """0..1, by logistic regression."""
    return float(1.0 / (1.0 + np.exp(-WEIGHTS @ features(explained, margin, points, detection))))
