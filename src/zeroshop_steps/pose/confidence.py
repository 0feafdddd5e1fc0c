"""The probability that an estimated pose is right, computed without the truth."""

import numpy as np

SAME_DIAMETERS = 0.1
"""A pose is right if no point of the model is off by more (MSSD), with symmetries."""
SURE_CONFIDENCE = 0.8
"""A less confident pose may be that of a part: detections of the object that touch are then tried as one."""
CLEAR_MARGIN = 0.2
"""Margin over the next best pose, in shares of the explained image; a larger one makes an estimate no surer."""
WEIGHTS = np.array([-7.34, 11.13, 3.76, -0.85])
"""Logistic regression on 210 estimates from detected masks of right and wrong objects, with the true models, in 12 virtual images:
the test set of the demo objects with seed 1, two images per scene. No published figure is about these images."""


def make_features(explained: float, margin: float, points: int) -> np.ndarray:
    """(4,) inputs of the regression: 1, the explained share of the image, the margin over another pose, the number of points."""
    return np.array([1.0, explained, min(margin, CLEAR_MARGIN) / CLEAR_MARGIN, np.log10(max(points, 1)) - 3.0])


def estimate_confidence(explained: float, margin: float, points: int) -> float:
    """Probability, 0..1, that an estimate is right; the arguments are those of `PoseEstimate`.

    The confidence of the detection is not used: its weight was only 0.03, and every detector defines it differently.
    """
    return float(1.0 / (1.0 + np.exp(-WEIGHTS @ make_features(explained, margin, points))))
