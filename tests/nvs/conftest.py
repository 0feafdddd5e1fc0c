"""What the tests of both optimizers train on."""

import numba
import numpy as np
import pytest
import torch
from ball import ball_view

from zeroshop_steps.nvs.views import TrainingView


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Images this small gain nothing from a second thread, and lose much on a busy machine."""
    numba.set_num_threads(1)
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def ball() -> tuple[list[TrainingView], list[np.ndarray]]:
    pairs = [ball_view(azimuth, elevation) for elevation in (-25.0, 25.0) for azimuth in range(0, 360, 36)]
    return [view for view, _ in pairs], [depth for _, depth in pairs]
