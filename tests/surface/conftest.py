"""What the tests of both optimizers train on."""

import numpy as np
import pytest

from helpers.ball import ball_views
from zeroshop_steps.surface.rendering.training_views import TrainingView


@pytest.fixture(scope="module")
def ball() -> tuple[list[TrainingView], list[np.ndarray]]:
    return ball_views()
