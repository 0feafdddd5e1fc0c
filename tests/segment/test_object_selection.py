"""Which of several things on the ground is meant."""

from dataclasses import replace

import numpy as np
import pytest

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.geometry.viewpoints import look_at
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.object_selection import select_object
from zeroshop_steps.segment.voxel_carving import splat_voxels

INTRINSICS = np.array([[200.0, 0, 80], [0, 200, 60], [0, 0, 1]])
SUPPORT = SceneSupport(np.array([0.0, 0, 1]), 0.0, np.array([0.0, 0, 8]), 100.0, 100)
CAMERAS = [
    Camera(f"{index}.png", 160, 120, INTRINSICS, look_at(100 * np.array([np.cos(a) * 0.8, np.sin(a) * 0.8, 0.6]), np.array([0.0, 0, 5])))
    for index, a in enumerate(np.linspace(0, 2 * np.pi, 10, endpoint=False))
]


WIDE_CAMERAS = [
    replace(camera, width_px=320, height_px=320, intrinsics=np.array([[120.0, 0, 160], [0, 120, 210], [0, 0, 1]])) for camera in CAMERAS
]


def blocks(*boxes, cameras=CAMERAS):
    """Evidence of boxes (x, y, half width, height) that stand on the ground, in all views."""
    points = []
    for x, y, half, height in boxes:
        grid = np.stack(np.meshgrid(*[np.linspace(-half, half, 15)] * 2, np.linspace(0, height, 15), indexing="ij"), -1).reshape(-1, 3)
        points.append(grid + [x, y, 0])
    return silhouettes(np.concatenate(points), cameras)


def silhouettes(points, cameras, spacing=1.5):
    return [np.where(splat_voxels(points, spacing, camera), 1.0, -1.0).astype(np.float32) for camera in cameras]


def extent(selection):
    """Mean position of the chosen cluster on the ground, and its width."""
    centres = selection.grid.centres(np.argwhere(selection.cluster))
    return centres[:, :2].mean(0), np.ptp(centres[:, :2], axis=0)


def test_the_thing_in_the_middle_is_meant():
    selection = select_object(SUPPORT, CAMERAS, blocks((1, 0, 5, 12), (24, 5, 4, 10), (-20, 14, 6, 8)))
    middle, width = extent(selection)
    # Voxels of 1.2 and the cones behind the block widen it by two voxels and half a splat at either side; its neighbours are 8 off.
    assert np.abs(middle - [1, 0]).max() < 1.5 and (width < 17).all()
    assert selection.cluster_count == 3 and len(selection.other_points) > 100
    assert (selection.allowed & selection.cluster).sum() == selection.cluster.sum()


def test_two_objects_are_refused():
    with pytest.raises(StepError, match="2 objects stand equally near"):
        select_object(SUPPORT, CAMERAS, blocks((13, 0, 5, 10), (-13, 0, 5, 10)))


def test_parts_close_together_are_one_object():
    middle, width = extent(select_object(SUPPORT, CAMERAS, blocks((6, 0, 3, 8), (-6, 0, 3, 8))))
    assert abs(middle[0]) < 1.5 and width.max() > 14


def test_what_the_photos_cut_off_is_not_meant_where_they_show_another_thing_whole():
    front = [-2, -1, 0, 1, 2]  # from there, the second box stands behind the first
    evidence = blocks((14, 0, 5, 10), (-12, 0, 6, 14))
    with pytest.raises(StepError, match="2 objects stand equally near"):
        select_object(SUPPORT, [CAMERAS[index] for index in front], [evidence[index] for index in front])
    lower = [CAMERAS[index].cropped(0, 45, 160, 75) for index in front]
    middle, _ = extent(select_object(SUPPORT, lower, [evidence[index][45:] for index in front]))
    assert np.abs(middle - [14, 0]).max() < 1.5


def test_the_thing_in_the_middle_is_meant_though_the_photos_cut_it_off():
    close = [camera.cropped(60, 40, 40, 40) for camera in CAMERAS]
    middle, _ = extent(select_object(SUPPORT, close, [odds[40:80, 60:100] for odds in blocks((1, 0, 9, 20), (24, 5, 4, 10))]))
    assert np.abs(middle - [1, 0]).max() < 3


@pytest.mark.parametrize("size", [(6, 6, 96), (104, 6, 6), (6, 110, 12)])
def test_a_tall_or_long_thing_is_found_whole(size):
    axes = [np.arange(0, extent, 1.0) - (0 if axis == 2 else extent / 2) for axis, extent in enumerate(size)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    selection = select_object(SUPPORT, WIDE_CAMERAS, silhouettes(points, WIDE_CAMERAS, spacing=1.0))
    found = np.ptp(selection.grid.centres(np.argwhere(selection.cluster)), axis=0)
    assert (np.abs(found - size) < 6).all()  # as above, and higher up the cones are longer


def test_a_thing_in_front_of_a_room_of_its_colours_stays_within_the_block():
    """Where all around counts as the object, too, no block is large enough."""
    everywhere = [np.ones((320, 320), np.float32) for _ in WIDE_CAMERAS]
    selection = select_object(SUPPORT, WIDE_CAMERAS, everywhere)
    assert np.ptp(selection.grid.centres(np.argwhere(selection.cluster)), axis=0).max() < 85
