"""Ways in which a pass may lie to another by its outlines: one of an uneven thing, several of an even one."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from helpers.shape_outlines import capture
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_camera, transform_points
from zeroshop_steps.join import outline_ways
from zeroshop_steps.join.evidence import ELSEWHERE_PX, ELSEWHERE_TIMES, SURE_MISS_PX
from zeroshop_steps.join.outline_ways import find_ways_by_outlines, make_turns
from zeroshop_steps.register.submodels.outline_alignment import CameraGroup, measure_misses


def put_down(shape: trimesh.Trimesh) -> tuple[trimesh.Trimesh, np.ndarray]:
    """The shape on another of its sides, and the (4, 4) rotation that brings it back."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("xz", [90, 130], degrees=True).as_matrix()
    return shape.copy().apply_transform(turn), np.linalg.inv(turn)


def uneven() -> trimesh.Trimesh:
    """A box with a handle on one side and a neck on another."""
    parts = [trimesh.creation.box((70, 40, 90)), trimesh.creation.box((20, 14, 50)), trimesh.creation.box((18, 18, 30))]
    parts[1].apply_translation((42, 5, 10))
    parts[2].apply_translation((-15, -6, 55))
    return trimesh.util.concatenate(parts)


@pytest.fixture
def fewer_turns(monkeypatch):
    """A coarser search, for shapes of which one is enough."""
    for name, value in {"AXES": 80, "ANGLES": 12, "TRIED": 16, "REFINED": 3}.items():
        monkeypatch.setattr(outline_ways, name, value)


def test_turns_are_rotations_and_leave_no_gap():
    turns = make_turns()
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-12) and np.allclose(np.linalg.det(turns), 1)
    any_turns = Rotation.random(200, random_state=0).as_matrix()
    cosines = (np.einsum("aij,bij->ab", any_turns, turns).max(1) - 1) / 2
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 16


def test_a_thinned_group_misses_as_the_whole_one_does():
    shape = uneven()
    turned, back = put_down(shape)
    groups = capture(shape), capture(turned)
    few = [group.thin(8, 100, 6, 200.0) for group in groups]
    assert all(len(thin.starts) == 100 and len(thin.points) <= 600 for thin in few)
    assert measure_misses(*few, back).mean() < 1.5 and measure_misses(*groups, back).mean() < 1.5
    wrong = back @ np.diag([-1.0, -1.0, 1.0, 1.0])
    assert measure_misses(*groups, wrong).max() == 30 < measure_misses(*few, wrong).max()  # a first look tells far from farther


@pytest.mark.slow
def test_an_uneven_thing_fits_in_one_way_whatever_frame_and_unit_its_second_pass_has(fewer_turns):
    shape = uneven()
    turned, back = put_down(shape)
    second = capture(turned)
    own = np.eye(4)
    own[:3, :3], own[:3, 3] = 0.6 * Rotation.random(random_state=3).as_matrix(), [40.0, -90.0, 150.0]
    masks = {camera.name: distance > 0 for camera, distance in zip(second.cameras, second.distances, strict=True)}
    moved = CameraGroup([transform_camera(camera, own) for camera in second.cameras], masks)
    best, *others = find_ways_by_outlines(capture(shape), moved)
    true = back @ np.linalg.inv(own)
    places = transform_points(turned.vertices, own)
    off_mm = np.linalg.norm(transform_points(places, best.target_from_source) - transform_points(places, true), axis=1)
    assert off_mm.max() < 1.0 and abs(compute_scale(best.target_from_source) * 0.6 - 1) < 0.01
    assert best.miss_px < SURE_MISS_PX and others[0].miss_px > max(best.miss_px + ELSEWHERE_PX, ELSEWHERE_TIMES * best.miss_px)


@pytest.mark.slow
def test_a_box_fits_in_several_ways(fewer_turns):
    shape = trimesh.creation.box((90, 60, 40))
    best, second, *_ = find_ways_by_outlines(capture(shape), capture(put_down(shape)[0]))
    assert second.miss_px < best.miss_px + 0.5
