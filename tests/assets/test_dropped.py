"""A body that is dropped comes to rest in MuJoCo: it neither sinks in nor explodes."""

import numpy as np
import pytest

from helpers.drop import drop


@pytest.mark.parametrize("folder", ["box_folder", "cylinder_folder"])
def test_a_dropped_body_comes_to_rest(folder, request):
    ended = drop(request.getfixturevalue(folder) / "2dgs.mjcf.xml", seed=3)
    assert ended.speed_m_s < 0.01 and ended.turn_rad_s < 0.2
    assert -0.001 < ended.lowest_m < 0.002, "on the plane"
    assert ended.highest_speed_m_s < 3.0 and np.isfinite(ended.place_m).all()
