"""Up from how photos were held, where some or all lie on their side without a word of it in their files."""

from types import SimpleNamespace

import numpy as np
import pytest

from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at
from zeroshop_steps.geometry.support.ground_plane import estimate_up_from_roll


def take_views(azimuths_deg, elevation_deg, rolls_deg):
    """Views of one size by hand: a few degrees off, and rolled so far."""
    rng = np.random.default_rng(0)
    for azimuth, roll in zip(azimuths_deg, rolls_deg, strict=True):
        angles = np.radians([azimuth, elevation_deg] + rng.normal(0, 3, 2))
        camera_from_world = look_at(3 * direction_at(*angles), np.zeros(3))
        c, s = np.cos(np.radians(roll + rng.normal(0, 3))), np.sin(np.radians(roll))
        camera_from_world[:2, :3] = np.array([[c, -s], [s, c]]) @ camera_from_world[:2, :3]
        yield SimpleNamespace(camera=SimpleNamespace(width_px=640, height_px=480, camera_from_world=camera_from_world))


@pytest.mark.parametrize("arc_deg", [60, 120, 340])
@pytest.mark.parametrize("elevation_deg", [25, 60])
@pytest.mark.parametrize("sideways", [(), (1, 4, 5), (0, 2, 3, 5, 7, 8, 9), range(12)])
@pytest.mark.parametrize("turns", [(90, 90), (90, -90)])
def test_photos_on_their_side_do_not_tilt_up(arc_deg, elevation_deg, sideways, turns):
    rolls = [turns[number % 2] if number in sideways else 0 for number in range(12)]
    up, _ = estimate_up_from_roll(list(take_views(np.linspace(0, arc_deg, 12), elevation_deg, rolls)))
    assert up[2] > np.cos(np.radians(10))
