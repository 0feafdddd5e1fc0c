"""An object that was found in part only gets a room that fits all of it, and not that of others; and its fragments belong to it."""

import numpy as np
import pytest

from helpers.camera_ring import ring_camera
from zeroshop_steps.segment.objects import BELOW_VOXELS, COARSE_VOXELS, MARGIN, Room, SceneObjects, cut_block, fit_room, join_fragments
from zeroshop_steps.segment.support_voxels import VoxelGrid

FOOT = BELOW_VOXELS


def box(low, high) -> np.ndarray:
    """(X, Y, Z) bool."""
    occupied = np.zeros((COARSE_VOXELS,) * 3, bool)
    occupied[tuple(slice(*ends) for ends in zip(low, high, strict=True))] = True
    return occupied


def found_of(*objects) -> SceneObjects:
    labels = np.zeros((COARSE_VOXELS,) * 3, int)
    for number, own in enumerate(objects, 1):
        labels[own] = number
    return SceneObjects(VoxelGrid(np.eye(3), np.zeros(3), 0.1, labels.shape), labels, FOOT, (1.0,) * len(objects))


def solve_in(found: SceneObjects, room: Room, truth: np.ndarray) -> Room | None:
    """The next room, where all of the true object that the room allows is solved."""
    block = cut_block(found, 1, room)
    hull = block.allowed & found.grid.look_up(truth, block.grid.centres(np.argwhere(np.ones(block.allowed.shape, bool)))).reshape(
        block.allowed.shape
    )
    return fit_room(found, room, block.grid, hull)


@pytest.mark.parametrize("way", ["up", "aside"])
def test_a_room_grows_where_the_object_is_cut_off(way):
    """A bar of which a quarter was found: rooms become longer that way until it is whole, and then fit it."""
    part = box((40, 40, FOOT), (50, 50, FOOT + 10)) if way == "up" else box((20, 40, FOOT), (30, 50, FOOT + 10))
    truth = box((40, 40, FOOT), (50, 50, FOOT + 40)) if way == "up" else box((20, 40, FOOT), (60, 50, FOOT + 10))
    found, room = found_of(part), Room(part, part)
    rooms = []
    while (room := solve_in(found, room, truth)) is not None:
        rooms.append(room)
        assert len(rooms) < 5
    assert all(not (one.reach & ~one.own).any() for one in rooms[-1:]) and (rooms[0].reach & ~rooms[0].own).any()
    assert (rooms[-1].own == truth).all()
    low, high = (np.argwhere(rooms[0].reach).min(0), np.argwhere(rooms[0].reach).max(0))
    grown = 2 if way == "up" else 0
    other = [axis for axis in range(3) if axis != grown]
    assert (low[other] == np.argwhere(part).min(0)[other]).all() and (high[other] == np.argwhere(part).max(0)[other]).all()


def test_a_whole_object_keeps_its_room():
    part = box((40, 40, FOOT), (50, 50, FOOT + 20))
    assert solve_in(found_of(part), Room(part, part), part) is None


def test_a_longer_room_leaves_others_alone():
    """A bar that points at another object: what is nearer to that one is not its own."""
    part, other = box((20, 40, FOOT), (30, 50, FOOT + 10)), box((60, 40, FOOT), (70, 50, FOOT + 10))
    found = found_of(part, other)
    room = solve_in(found, Room(part, part), box((20, 40, FOOT), (40, 50, FOOT + 10)))
    assert room is not None and room.reach[40, 45, FOOT + 5]
    block = cut_block(found, 1, room)
    allowed = found.grid.locate(block.grid.centres(block.index))[0][:, 0]
    assert allowed.max() < 50 and allowed.min() < 20 + int(MARGIN * 10)


def test_what_photos_show_within_an_object_is_a_part_of_it():
    """A box without its front's foot but a splinter of that, seen from the front; and another thing beside it, which is none."""
    whole = box((40, 40, FOOT), (56, 56, FOOT + 16))
    whole[40:56, 36:44, FOOT : FOOT + 8] = False
    splinter, other = box((46, 38, FOOT), (50, 40, FOOT + 5)), box((66, 40, FOOT), (72, 46, FOOT + 6))
    cameras = [ring_camera(index, 24, 8.0, (25, 45), (4.8, 4.8, 0.8), 260.0, (240, 180)) for index in range(15, 22)]
    found = found_of(whole, other, splinter)
    joined = join_fragments(found, cameras)
    assert joined is not None and joined.count == 2 and len(joined.ratings) == 2
    assert ((joined.labels == 1) == whole | splinter).all() and ((joined.labels == 2) == other).all()
    assert join_fragments(found_of(whole, other), cameras) is None
