"""Sides that look alike, laid onto each other: neighbouring views differ in detail."""

from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh

from helpers.camera_ring import ring_camera
from zeroshop_steps.geometry.cameras import write_cameras
from zeroshop_steps.geometry.images import write_image, write_mask
from zeroshop_steps.geometry.mesh_rendering import MeshRenderer
from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.geometry.registered_views import read_views
from zeroshop_steps.register.neighbour_agreement import check_neighbours, find_disagreeing
from zeroshop_steps.register.record import RegistrationFailed

VIEWS = 24
SEEN = [*range(6), *range(12, 18)]  # of them, a part of the front and of the back


def can_with_two_faces() -> Mesh:
    """A can with the same large shapes on both sides, and other small ones beside them."""
    rng = np.random.default_rng(3)
    coarse = cv2.resize(rng.integers(60, 200, (6, 8, 3), dtype=np.uint8), (400, 300), interpolation=cv2.INTER_CUBIC)
    fine = cv2.resize(rng.integers(0, 56, (75, 200, 3), dtype=np.uint8), (800, 300), interpolation=cv2.INTER_NEAREST)
    solid = trimesh.creation.cylinder(35, 100, sections=96)
    corners = np.asarray(solid.vertices)[solid.faces]
    turns = np.arctan2(corners[..., 1], corners[..., 0]) / (2 * np.pi)
    turns -= np.round(turns - turns[:, :1])  # the corners of a face on one side of the seam
    uv = np.stack([np.clip(turns + 0.5, 0, 1), corners[..., 2] / 100 + 0.5], -1)
    texture = cv2.add(np.hstack([coarse, coarse]), fine)
    return Mesh(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3), None, uv.reshape(-1, 2), texture)


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


def fold(views):
    """The back's views, believed to stand beside the front's: 7.5 degrees from them."""
    half, turn = len(SEEN) // 2, np.radians(180 + 7.5)
    world = np.eye(4)
    world[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    turned = [
        replace(view, camera=replace(view.camera, camera_from_world=view.camera.camera_from_world @ np.linalg.inv(world)))
        for view in views[half:]
    ]
    return views[:half] + turned


@pytest.mark.slow
def test_right_cameras_agree(views):
    figures = {}
    check_neighbours(read_views(views)[0], figures, pycolmap.Reconstruction())
    assert figures == {"compared_neighbours": len(SEEN) - 2, "disagreeing": []}


@pytest.mark.slow
def test_sides_that_look_alike_are_refused(views):
    figures = {}
    with pytest.raises(RegistrationFailed, match="sides that look alike lie on each other. .* differ in detail"):
        check_neighbours(fold(read_views(views)[0]), figures, pycolmap.Reconstruction())
    false = [pair for pair in figures["disagreeing"] if len({int(name) < VIEWS // 2 for name in pair}) == 2]
    assert len(false) == len(figures["disagreeing"]) > 0.35 * figures["compared_neighbours"], "neighbours of one side still agree"


def test_views_that_are_far_apart_are_not_judged(views):
    assert find_disagreeing(read_views(views)[0][::2]) == (0, [])
