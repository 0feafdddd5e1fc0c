"""What the tests of both optimizers train on."""

import numba
import numpy as np
import pytest
import torch

from helpers.ball import ball_views
from zeroshop_steps.surface.training_views import TrainingView


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Images this small gain nothing from a second thread, and lose much on a busy machine."""
    numba.set_num_threads(1)
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def ball() -> tuple[list[TrainingView], list[np.ndarray]]:
    return ball_views()
