"""Plain things of one shape all around are joined in any turn about their upright axis; nothing else is."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from helpers.shape_outlines import capture
from zeroshop_steps.join.evidence import LARGEST_MISS_PX, Judgement, PassObservation
from zeroshop_steps.join.passes import MOST_TELLING, choose_any, explain_joined, fits_itself
from zeroshop_steps.join.ways import Way
from zeroshop_steps.register.submodels.appearance import Likeness

PLAIN = Likeness(20, 900, 0.7, 0.3, 0, 0.0)
PRINTED = Likeness(20, 900, 0.7, 0.3, MOST_TELLING + 1, 0.2)


def turn(axis: str, angle_deg: float, scale: float = 1.0) -> np.ndarray:
    similarity = np.eye(4)
    similarity[:3, :3] = scale * Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    return similarity


def sight_of(shape: trimesh.Trimesh) -> PassObservation:
    return PassObservation([], capture(shape))


@pytest.fixture(scope="module")
def cone() -> PassObservation:
    """Of one shape all around, but not upside down."""
    return sight_of(trimesh.creation.revolve(np.array([[0, -30], [25, -30], [60, 30], [0, 30]]), sections=64))


@pytest.fixture(scope="module")
def box() -> PassObservation:
    return sight_of(trimesh.creation.box((90, 50, 60)))


def open_way(way: np.ndarray, miss_px: float = 0.1, likeness: Likeness = PLAIN) -> Judgement:
    return Judgement(Way(way, 0), miss_px, likeness, miss_px)


def test_outlines_tell_which_turns_leave_a_shape_as_it_is(cone: PassObservation, box: PassObservation) -> None:
    assert fits_itself(cone, turn("z", 37)) and fits_itself(cone, turn("z", 180))
    assert not fits_itself(cone, turn("x", 180)) and not fits_itself(cone, turn("x", 40))
    assert fits_itself(box, turn("z", 180)) and not fits_itself(box, turn("z", 90))
    assert not fits_itself(box, turn("x", 180)), "its underside is another side, which the pass did not see"


def test_any_turn_will_do_where_the_shape_is_the_same_in_all(cone: PassObservation) -> None:
    upside_down = turn("x", 180, 2.0)
    ways = [open_way(upside_down, 0.2), open_way(upside_down @ turn("z", 50), 0.1), open_way(upside_down @ turn("z", 130), 0.3)]
    profile = np.array([[0, -60], [120, -60], [50, 60], [0, 60]])  # the same, twice as large, on its head
    target = sight_of(trimesh.creation.revolve(profile, sections=64))
    assert choose_any(ways, target, cone) is ways[1]
    assert "print that only one of the passes shows" in str(explain_joined(2, ways[1], target, cone))


def test_nothing_is_guessed_where_the_ways_differ(cone: PassObservation, box: PassObservation) -> None:
    def chosen(*found: Judgement, sight: PassObservation = cone) -> Judgement | None:
        return choose_any(list(found), sight, sight)

    straight, turned = np.eye(4), turn("z", 90)
    assert chosen(open_way(straight), open_way(turned)) is not None
    assert chosen(open_way(straight), open_way(turned), sight=box) is None
    assert chosen(open_way(straight)) is None, "one way alone that nothing shows to be right"
    assert chosen(open_way(straight, LARGEST_MISS_PX + 1), open_way(turned, LARGEST_MISS_PX + 1)) is None
    assert chosen(open_way(straight), open_way(turned, likeness=PRINTED)) is None
    assert chosen(Judgement(Way(straight, 200), 0.1, PLAIN), open_way(turned)) is None, "print says which"
