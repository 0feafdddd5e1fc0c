"""How probable it is that an estimated pose is right, from what can be seen without knowing the truth."""

import numpy as np

SAME_DIAMETERS = 0.1
"""A pose is right where no point of the model is off by more (MSSD), symmetries taken into account."""
CLEAR_MARGIN = 0.2
WEIGHTS = np.array([-7.34, 11.13, 3.76, -0.85])
"""Logistic regression on 210 estimates from detected masks, right and wrong objects among them, in 12 virtual test images that no
published figure is about (the test set of the demo objects with seed 1, two images a scene, the true models)."""


def make_features(explained: float, margin: float, points: int) -> np.ndarray:
    """(4,) what the probability is made of: 1, how well the image is explained, how much better than by another pose, the size."""
    return np.array([1.0, explained, min(margin, CLEAR_MARGIN) / CLEAR_MARGIN, np.log10(max(points, 1)) - 3.0])


def estimate_confidence(explained: float, margin: float, points: int) -> float:
    """0..1 of one estimate: its share of the image that is explained and margin (`PoseEstimate`), and its measured points.

    The detection's own confidence adds nothing to these (its weight came out as 0.03) and means something else with every detector.
    """
    return float(1.0 / (1.0 + np.exp(-WEIGHTS @ make_features(explained, margin, points))))
