"""A tall object stands before the room: what the ground does not tell of it, its colours do."""

import numpy as np
import pytest

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.geometry.viewpoints import look_at
from zeroshop_steps.segment.object_selection import select_object
from zeroshop_steps.segment.voxel_carving import splat_voxels

INTRINSICS = np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]])
SUPPORT = SceneSupport(np.array([0.0, 0, 1]), 0.0, np.array([0.0, 0, 10]), 100.0, 100)
CAMERAS = [
    Camera(f"{index}.png", 160, 120, INTRINSICS, look_at(100 * np.array([np.cos(a), np.sin(a), 0.25]), np.array([0.0, 0, 15])))
    for index, a in enumerate(np.linspace(0, 2 * np.pi, 12, endpoint=False))
]
HEIGHT, TABLE_RADIUS = 36.0, 25.0


def tower(low: float, high: float) -> np.ndarray:
    """(P, 3) points of a box 10 wide between two heights."""
    return np.stack(np.meshgrid(*[np.linspace(-5, 5, 11)] * 2, np.arange(low, high), indexing="ij"), -1).reshape(-1, 3)


@pytest.fixture(scope="module")
def evidence() -> list[np.ndarray]:
    """Log odds by a small table: the tower before it is told, and nothing is known of what stands before the room."""
    angle, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 200), np.linspace(0, TABLE_RADIUS, 60))
    table = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], -1).reshape(-1, 3)
    found = []
    for camera in CAMERAS:
        known, object_here = splat_voxels(table, 1.5, camera), splat_voxels(tower(0, HEIGHT), 1.5, camera)
        found.append(np.where(known, np.where(object_here, 1.0, -1.0), 0.0).astype(np.float32))
    return found


def pictures(room: tuple[int, int, int]) -> list[np.ndarray]:
    """A purple tower, before a room of this colour."""
    rng = np.random.default_rng(0)
    drawn = []
    for camera in CAMERAS:
        object_here = splat_voxels(tower(0, HEIGHT), 1.5, camera)
        drawn.append(
            (np.where(object_here[..., None], [140, 90, 190], room) + rng.normal(0, 4, (*object_here.shape, 3))).astype(np.float32)
        )
    return drawn


def top_of(selection) -> float:
    return float(selection.grid.centres(np.argwhere(selection.cluster))[:, 2].max())


def test_the_colours_of_the_object_tell_its_upper_part(evidence):
    by_ground = select_object(SUPPORT, CAMERAS, evidence)
    assert top_of(by_ground) < 0.8 * HEIGHT
    whole = select_object(SUPPORT, CAMERAS, evidence, images=pictures((190, 185, 170)))
    assert top_of(whole) > 0.95 * HEIGHT
    centres = whole.grid.centres(np.argwhere(whole.cluster))
    width = np.ptp(centres[np.abs(centres[:, 2] - 0.7 * HEIGHT) < 2][:, :2], axis=0)
    assert (width < 18).all()  # 10, a voxel of 1.2 and half a splat at either side, and two views may miss it


def test_in_a_room_of_its_own_colours_nothing_is_added(evidence):
    by_ground = select_object(SUPPORT, CAMERAS, evidence)
    same = select_object(SUPPORT, CAMERAS, evidence, images=pictures((140, 90, 190)))
    assert np.array_equal(same.cluster, by_ground.cluster)
