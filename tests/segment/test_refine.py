"""What the masks share is carved to one standing thing."""

import numpy as np
import pytest

from helpers.camera_ring import ring_camera
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.object_selection import ObjectSelection
from zeroshop_steps.segment.refine import _close_holes, _drop_floating, _learn_colors, _restore_lost_foot, refine_masks
from zeroshop_steps.segment.voxel_carving import VoxelGrid, render_silhouettes


def block(*boxes):
    occupied = np.zeros((40, 40, 60), bool)
    for low, high in boxes:
        occupied[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    return occupied


def test_what_floats_goes_and_what_stands_or_touches_stays():
    body = ((15, 15, 3), (25, 25, 30))
    finial = ((19, 19, 32), (21, 21, 36))  # a thin neck of two voxels was lost between them
    foot = ((30, 30, 3), (33, 33, 20))  # a part of its own that stands
    floating = ((2, 2, 45), (30, 30, 58))
    assert np.array_equal(_drop_floating(block(body, finial, foot, floating), 2.0), block(body, finial, foot, floating) & ~block(floating))
    kept = block(body, finial, foot)
    assert np.array_equal(_drop_floating(kept | block(floating), 2.0), kept)
    assert np.array_equal(_drop_floating(block(body), 2.0), block(body))
    assert not _drop_floating(block(), 2.0).any()


def test_an_object_whose_foot_was_carved_off_is_kept_and_may_have_it_back():
    body, splinter = ((15, 15, 14), (25, 25, 50)), ((33, 33, 2), (35, 35, 4))
    kept = _drop_floating(block(body, splinter), 2.0)
    assert np.array_equal(kept, block(body))
    assert np.array_equal(_restore_lost_foot(kept, 2.0), block(((15, 15, 2), (25, 25, 50))))
    standing = block(((15, 15, 3), (25, 25, 50)), ((12, 12, 45), (28, 28, 50)))
    assert np.array_equal(_restore_lost_foot(standing, 2.0), standing), "what lies below a rim is no foot where the body stands"
    assert not _restore_lost_foot(block(), 2.0).any()


def test_a_hole_in_the_objects_own_colours_is_none():
    mask = np.zeros((60, 80), np.float32)
    mask[10:50, 10:70] = 1.0
    mask[20:30, 20:30] = mask[20:30, 50:60] = 0.0  # the floor of a bowl; a handle that one looks through
    mask[40:55, 30:34] = 0.0  # no hole: it opens to the outside
    color = np.where(mask > 0, 1.5, -1.0)
    color[20:30, 20:30] = color[40:55, 30:34] = 1.2
    found = _close_holes(mask, color)
    expected = mask.copy()
    expected[20:30, 20:30] = 1.0
    assert np.array_equal(found, expected)
    assert np.array_equal(_close_holes(np.zeros((5, 6), np.float32), np.ones((5, 6))), np.zeros((5, 6)))
    assert np.array_equal(_close_holes(np.ones((5, 6), np.float32), np.ones((5, 6))), np.ones((5, 6)))


@pytest.mark.parametrize(("share", "missing"), [(0.0, "object"), (1.0, "background")])
def test_what_fills_the_photos_or_is_nowhere_is_told(share, missing):
    hull = np.full((40, 60), bool(share))
    with pytest.raises(StepError, match=f"no place is surely {missing}; keep the whole object in the middle"):
        _learn_colors([np.full((40, 60, 3), 90.0, np.float32)], [hull], [np.zeros((40, 60), np.float32)])


def test_another_thing_is_left_out_though_all_but_its_place_says_that_it_is_the_object():
    """It differs from the ground, and a network takes it along in all photos; photos show it behind the object or beside it."""
    cameras = [ring_camera(index, 10, 4.0, (25, 45), (0.0, 0.0, 0.3), 260.0, (160, 120)) for index in range(10)]
    grid = VoxelGrid(np.eye(3), np.array([-1.0, -1.0, 0.0]), 0.05, (40, 40, 20))
    own, other, near = (np.zeros(grid.shape, bool) for _ in range(3))
    own[14:26, 14:26, :16] = other[31:36, 16:24, :12] = near[10:30, 10:30, :18] = True
    points = grid.centres(np.argwhere(other))
    masks, behind = (render_silhouettes(grid, part, cameras) for part in (own, other))
    rng = np.random.default_rng(0)
    images = []
    for mask, thing in zip(masks, behind, strict=True):
        image = rng.normal(120, 2, (*mask.shape, 3)).astype(np.float32)
        image[thing] += (60, -50, 40)
        image[mask] = rng.normal((220, 190, 60), 2, (mask.sum(), 3))
        images.append(image)
    odds = [1.5 * (2.0 * (mask | thing).astype(np.float32) - 1.0) for mask, thing in zip(masks, behind, strict=True)]
    support = SceneSupport(np.array([0.0, 0.0, 1.0]), 0.0, np.array([0.0, 0.0, 0.3]), 4.0, 0)
    selection = ObjectSelection(grid, near, own, 0.0, points, grid.side, 2)
    none = [np.zeros_like(part) for part in odds]
    found = refine_masks(support, selection, cameras, images, odds, none, [2.5 / 1.5 * part for part in odds], np.zeros((0, 3)))
    overlaps = [((found > 0.5) & mask).sum() / ((found > 0.5) | mask).sum() for found, mask in zip(found.masks, masks, strict=True)]
    assert min(overlaps) > 0.9


def test_windows_keep_the_other_things_of_the_whole_images():
    grid = VoxelGrid(np.eye(3), np.zeros(3), 0.1, (10, 10, 10))
    own = np.zeros(grid.shape, bool)
    own[2:5, 2:5, 2:5] = True
    closer = ObjectSelection(grid, own, own, 0.0, np.zeros((0, 3)), 0.1, 1)
    points = np.array([[0.35, 0.35, 0.35], [0.75, 0.35, 0.35], [3.0, 0.0, 0.2]])  # now a part of the object; in the windows; outside
    found = closer.with_others_of(ObjectSelection(grid, own, own, 0.0, points, 0.4, 3))
    assert np.array_equal(found.other_points, points[1:]) and found.other_side == 0.4 and found.cluster is own
