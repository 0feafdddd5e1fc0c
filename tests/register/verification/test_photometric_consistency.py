"""Sides that look alike, laid onto each other: neighbouring views differ in detail."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.camera_ring import ring_camera
from helpers.two_faced_can import can_with_two_faces
from zeroshop_steps.geometry.cameras import write_cameras
from zeroshop_steps.geometry.images import write_image, write_mask
from zeroshop_steps.geometry.mesh_rendering import MeshRenderer
from zeroshop_steps.geometry.registered_views import read_views
from zeroshop_steps.register.scene.record import DuplicateStructure, Evidence, Record
from zeroshop_steps.register.submodels.appearance import compare_groups
from zeroshop_steps.register.verification import photometric_consistency
from zeroshop_steps.register.verification.photometric_consistency import (
    FEW_COMPARED,
    check_photometric_consistency,
    check_wide_baseline,
    find_inconsistent,
)

VIEWS = 24
SEEN = [*range(6), *range(12, 18)]  # of them, a part of the front and of the back


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """The can, in steps of 15 degrees, as `undistort` writes it."""
    folder = tmp_path_factory.mktemp("can")
    cameras = [ring_camera(index, VIEWS, 320, (20, 20), (0, 0, 0), 500, (320, 240)) for index in SEEN]
    renderer = MeshRenderer(can_with_two_faces())
    for camera in cameras:
        write_image(folder / "images" / camera.name, renderer.render_color(camera, (120, 120, 120)))
        write_mask(folder / "masks" / camera.name, renderer.cast_rays(camera).mask)
    write_cameras(folder / "sparse", cameras)
    return folder


def fold(views, beside_deg=7.5):
    """The back's views, believed to stand beside the front's: 7.5 degrees from them."""
    half, turn = len(views) // 2, np.radians(180 + beside_deg)
    world = np.eye(4)
    world[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    turned = [
        replace(view, camera=replace(view.camera, camera_from_world=view.camera.camera_from_world @ np.linalg.inv(world)))
        for view in views[half:]
    ]
    return views[:half] + turned


@pytest.mark.slow
def test_right_cameras_agree(views):
    assert check_photometric_consistency(read_views(views)[0]) == Evidence({"compared_neighbours": len(SEEN) - 2, "disagreeing": []})


@pytest.mark.slow
def test_sides_that_look_alike_are_refused(views):
    found = check_photometric_consistency(fold(read_views(views)[0]))
    assert found.fault.kind is DuplicateStructure and "differ in detail" in found.fault.reason
    figures = found.entries
    false = [pair for pair in figures["disagreeing"] if len({int(name) < VIEWS // 2 for name in pair}) == 2]
    assert len(false) == len(figures["disagreeing"]) > 0.35 * figures["compared_neighbours"], "neighbours of one side still agree"


def test_views_that_are_far_apart_are_not_judged(views):
    assert find_inconsistent(read_views(views)[0][::2]) == (0, [])


@pytest.mark.slow
def test_views_some_way_apart_agree_in_right_cameras(views):
    found = check_wide_baseline(read_views(views)[0], 0)
    assert found.entries["compared_far_neighbours"] >= len(SEEN) - 2 and found.entries["differing"] == [] and not found.fault, found


def test_sides_that_look_alike_are_refused_where_no_views_are_near(views):
    folded = fold(read_views(views)[0][::3], 22.5)
    assert check_photometric_consistency(folded).entries["compared_neighbours"] == 0, "views 22.5 degrees apart are not near"
    fault = check_wide_baseline(folded, 0).fault
    assert fault.kind is DuplicateStructure and "sides that look alike lie on each other" in fault.reason


@pytest.mark.parametrize("judged, scores, refused", [(8, [0.7], False), (8, [0.59], True), (8, [0.7] * 3, True), (3, [0.65], True)])
def test_far_neighbours_are_excused_where_few_differ_a_little(monkeypatch, judged, scores, refused):
    found = {(f"{number}", f"{number + 1}"): score for number, score in enumerate(scores)}
    monkeypatch.setattr(photometric_consistency, "find_inconsistent_wide", lambda views: (judged, found))
    assert bool(check_wide_baseline([], 0).fault) == refused


def test_where_nothing_can_be_compared_a_warning_says_so(views):
    record = Record().warn("other").judge(check_wide_baseline(read_views(views)[0][::3][:2], 0))  # 45 degrees apart
    assert record.entries["compared_far_neighbours"] == 0 and record.entries["warnings"][0] == "other"
    assert "no two neighbouring photos show enough of the same print" in record.entries["warnings"][1]


def test_views_some_way_apart_are_not_asked_where_near_ones_were():
    assert check_wide_baseline([], FEW_COMPARED) == Evidence()


def test_groups_that_lie_rightly_show_the_same(views):
    right = read_views(views)[0]
    among = {view.camera.name for view in right[::2]}
    likeness = compare_groups(right, among)
    assert likeness.same and likeness.score > 0.85, likeness


def test_groups_laid_onto_the_wrong_side_do_not(views):
    folded = fold(read_views(views)[0])
    likeness = compare_groups(folded, {view.camera.name for view in folded[len(SEEN) // 2 :]})
    assert likeness.patches > 200 and not likeness.same, likeness


def test_groups_without_common_sides_are_not_called_the_same(views):
    right = read_views(views)[0]
    assert not compare_groups(right, {view.camera.name for view in right[len(SEEN) // 2 :]}).same


@pytest.mark.parametrize("judged, disagreeing, refused", [(2, 2, True), (1, 1, True), (8, 2, False), (20, 6, True), (0, 0, False)])
def test_where_few_are_judged_none_is_excused(monkeypatch, judged, disagreeing, refused):
    pairs = [(f"{number}", f"{number + 1}") for number in range(disagreeing)]
    monkeypatch.setattr(photometric_consistency, "find_inconsistent", lambda views: (judged, pairs))
    assert bool(check_photometric_consistency([]).fault) == refused
