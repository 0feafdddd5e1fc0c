"""Turn views by quarter turns until the world's z is up: arms hold cameras in any way, and the steps that follow expect upright photos."""

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.capture.cameras_json import Lens

SHARED = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
SEPARATE = ("PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE")
"""COLMAP's lenses that can be turned: those with one focal length, and those with two."""
TANGENTIAL = {"OPENCV": 6, "FULL_OPENCV": 6}
"""Where the two coefficients of tangential distortion begin."""
LEAST_GAIN = 0.2
"""By which a turn must bring the image's up direction nearer to the world's: a camera that looks straight down is upright in any turn."""


def make_upright(lens: Lens, world_from_camera: np.ndarray) -> tuple[int, Lens, np.ndarray]:
    """The quarter turns that make a view upright, for `np.rot90`, and the lens and (4, 4) world_from_camera after them."""
    turns = count_quarter_turns(lens, world_from_camera)
    return turns, turn_lens(lens, turns), turn_pose(world_from_camera, turns)


def count_quarter_turns(lens: Lens, world_from_camera: np.ndarray) -> int:
    """How many quarter turns, counterclockwise as `np.rot90` counts, make a view upright; 0 for lenses that cannot be turned."""
    if lens.model not in (*SHARED, *SEPARATE):
        return 0
    right, down = world_from_camera[2, 0], world_from_camera[2, 1]
    rise = np.array([-down, right, down, -right])
    best = int(rise.argmax())
    return best if rise[best] - rise[0] > LEAST_GAIN else 0


def turn_lens(lens: Lens, turns: int) -> Lens:
    """The lens of images after quarter turns."""
    for _ in range(turns % 4):
        lens = _turn_once(lens)
    return lens


def turn_pose(world_from_camera: np.ndarray, turns: int) -> np.ndarray:
    """(4, 4) world_from_camera of the turned images."""
    old_from_new = np.eye(4)
    old_from_new[:3, :3] = np.rint(Rotation.from_euler("z", 90.0 * turns, degrees=True).as_matrix())
    return np.asarray(world_from_camera @ old_from_new)


def _turn_once(lens: Lens) -> Lens:
    # A point's new column is its old row, its new row is the width less its old column.
    params = list(lens.params)
    if lens.model in SHARED:
        params[1:3] = lens.params[2], lens.width_px - lens.params[1]
    else:
        params[:4] = lens.params[1], lens.params[0], lens.params[3], lens.width_px - lens.params[2]
    if lens.model in TANGENTIAL:
        first = TANGENTIAL[lens.model]
        params[first : first + 2] = -lens.params[first + 1], lens.params[first]
    return Lens(lens.model, lens.height_px, lens.width_px, tuple(params))
