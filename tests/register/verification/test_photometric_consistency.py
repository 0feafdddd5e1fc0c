"""Sides that look alike, laid onto each other: neighbouring views differ in detail."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.camera_ring import ring_camera
from helpers.two_faced_can import can_with_two_faces
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.register.scene.record import DuplicateStructure, Record
from zeroshop_steps.register.submodels.appearance import compare_groups
from zeroshop_steps.register.verification import photometric_consistency
from zeroshop_steps.register.verification.photometric_consistency import (
    FEW_COMPARED,
    check_photometric_consistency,
    find_inconsistent,
    find_inconsistent_wide,
)
from zeroshop_steps.register.verification.verdict import MAX_WRONG_PROBABILITY, judge

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
    found = check_photometric_consistency(read_views(views)[0])
    assert found.entries == {"compared_neighbours": len(SEEN) - 2, "disagreeing": []} and found.findings[0].strength == 0


@pytest.mark.slow
def test_sides_that_look_alike_are_refused(views):
    found = check_photometric_consistency(fold(read_views(views)[0]))
    assert found.findings[0].strength > 1.4 and "differ in detail" in found.findings[0].found
    figures = found.entries
    false = [pair for pair in figures["disagreeing"] if len({int(name) < VIEWS // 2 for name in pair}) == 2]
    assert len(false) == len(figures["disagreeing"]) > 0.35 * figures["compared_neighbours"], "neighbours of one side still agree"


def test_views_that_are_far_apart_are_not_judged(views):
    assert find_inconsistent(read_views(views)[0][::2]) == (0, [])


@pytest.mark.slow
def test_views_some_way_apart_agree_in_right_cameras(views):
    judged, differing = find_inconsistent_wide(read_views(views)[0])
    assert judged >= len(SEEN) - 2 and not differing


def test_sides_that_look_alike_are_refused_where_no_views_are_near(views):
    folded = fold(read_views(views)[0][::3], 22.5)
    assert check_photometric_consistency(folded, wide=False).entries == {"compared_neighbours": 0, "disagreeing": []}, "not near"
    verdict = judge(check_photometric_consistency(folded).findings)
    assert (
        verdict.wrong > MAX_WRONG_PROBABILITY
        and verdict.kind is DuplicateStructure
        and "distinct sides were merged (duplicate structure)" in verdict.reason
    )


def test_where_nothing_can_be_compared_a_warning_says_so(views):
    record = Record().warn("other").judge(check_photometric_consistency(read_views(views)[0][::3][:2]))  # 45 degrees apart
    assert record.entries["compared_far_neighbours"] == 0 and record.entries["warnings"][0] == "other"
    assert "no two neighbouring photos show enough of the same print" in record.entries["warnings"][1]


@pytest.mark.parametrize("near, far, differing, strength", [(FEW_COMPARED, 9, 9, 0.0), (2, 6, 2, 1.0), (0, 8, 1, 0.5), (0, 0, 0, 0.0)])
def test_views_some_way_apart_count_only_where_few_near_ones_were_compared(monkeypatch, near, far, differing, strength):
    found = {(f"{number}", f"{number + 1}"): 0.5 for number in range(differing)}
    monkeypatch.setattr(photometric_consistency, "find_inconsistent", lambda views: (near, []))
    monkeypatch.setattr(photometric_consistency, "find_inconsistent_wide", lambda views: (far, found))
    assert check_photometric_consistency([]).findings[0].strength == strength


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
