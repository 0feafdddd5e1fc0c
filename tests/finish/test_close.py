"""Torn surfaces are closed: what was measured stays, holes follow the true shape, ground around the foot goes."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from helpers.carton_scene import camera_at
from helpers.memory_view import MemoryView
from helpers.solids import as_trimesh
from zeroshop_steps.finish.closing import watertight
from zeroshop_steps.finish.closing.close import Closing, close_in_space, close_mesh, fill_small_holes, find_floor
from zeroshop_steps.finish.closing.underside import close_underside, find_open_borders
from zeroshop_steps.finish.closing.watertight import GroundPlane
from zeroshop_steps.geometry.alignment.surface_distance import measure_distances
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer

pytestmark = pytest.mark.slow

UP = np.array([0.0, 0.0, 1.0])
RADIUS_MM, FOOT_MM = 30.0, -27.0
MAX_FACES = 12_000


def ball() -> Mesh:
    """A ball that stands on z = FOOT_MM, cut flat and open there; finer than the voxels that decide what is solid."""
    ball = trimesh.creation.icosphere(5, RADIUS_MM)
    vertices, faces, _ = trimesh.intersections.slice_faces_plane(ball.vertices, ball.faces, UP, np.array([0, 0, FOOT_MM]))
    mesh = trimesh.Trimesh(vertices, faces)
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces)).without_loose_vertices().with_normals()


def without_faces(mesh: Mesh, place: np.ndarray, radius_mm: float) -> Mesh:
    """The mesh with a hole around a place."""
    away = np.linalg.norm(mesh.vertices[mesh.faces].mean(1) - place, axis=1)
    return Mesh(mesh.vertices, mesh.faces[away > radius_mm]).without_loose_vertices().with_normals()


def cameras() -> list[Camera]:
    rings = [camera_at(f"low{k}.png", 36.0 * k, 12.0, 200.0) for k in range(10)]
    return rings + [camera_at(f"high{k}.png", 36.0 * k + 18.0, 50.0, 200.0) for k in range(10)]


@pytest.fixture(scope="module")
def views() -> list[View]:
    """The masks that photos of the whole ball have; every tenth lacks its upper half."""
    renderer = MeshRenderer(ball())
    found = []
    for index, camera in enumerate(cameras()):
        mask = renderer.cast_rays(camera).mask
        if index % 10 == 3:
            mask = mask & (np.arange(len(mask))[:, None] > len(mask) / 2)
        found.append(MemoryView(camera, Path(camera.name), None, mask))
    return found


def side() -> np.ndarray:
    return RADIUS_MM * np.array([np.cos(0.4), 0.0, np.sin(0.4)])


@pytest.fixture(scope="module")
def closed(views) -> tuple[Mesh, Mesh, Mesh]:
    """A ball with a wide hole in its side and a strip of ground around its foot, before and after; and which faces are unseen."""
    torn = without_faces(ball(), side(), 12.0)
    strip = trimesh.creation.annulus(15.0, 32.0, 0.4, transform=trimesh.transformations.translation_matrix([0, 0, FOOT_MM + 0.2]))
    strip = strip.subdivide().subdivide()
    torn = Mesh(
        np.concatenate([torn.vertices, strip.vertices]), np.concatenate([torn.faces, np.array(strip.faces) + len(torn.vertices)])
    ).with_normals()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(watertight, "COARSE", 80)
        patch.setattr(watertight, "FINE", 160)
        whole, record = close_in_space(torn, views, GroundPlane(UP, FOOT_MM), MAX_FACES)
    assert record.state == "closed" and record.first_face + record.faces == len(whole.faces)
    return torn, whole, Mesh(whole.vertices, whole.faces[record.first_face :])


def test_a_torn_surface_becomes_a_solid(closed):
    _, whole, _ = closed
    assert not find_open_borders(whole.faces) and as_trimesh(whole).is_watertight
    sphere = 4 / 3 * np.pi * RADIUS_MM**3
    assert as_trimesh(whole).volume == pytest.approx(sphere, rel=0.02)


def test_measured_surface_stays_where_it_was(closed):
    torn, whole, _ = closed
    kept = torn.vertices[torn.vertices[:, 2] > FOOT_MM + 4.0]
    away = measure_distances(whole, kept)
    assert np.median(away) < 0.03 and np.quantile(away, 0.99) < 0.3


def test_a_hole_is_closed_near_the_true_shape_in_spite_of_wrong_masks(closed):
    _, whole, _ = closed
    near = np.linalg.norm(whole.vertices - side(), axis=1) < 11.0
    depth = RADIUS_MM - np.linalg.norm(whole.vertices[near], axis=1)
    voxel, pixel = 1.12 * 2 * RADIUS_MM / 128, 200.0 / 420.0  # of the votes, in mm
    flat = RADIUS_MM - np.sqrt(RADIUS_MM**2 - 12.0**2)  # how deep a flat lid would lie below the ball, 2.5 mm
    assert near.sum() > 50 and -1.5 * pixel - voxel < depth.min() and depth.max() < flat / 2


def test_ground_around_the_foot_goes(closed):
    torn, whole, _ = closed
    assert GroundPlane(UP, FOOT_MM).ground_share(torn) > 0.01 > GroundPlane(UP, FOOT_MM).ground_share(whole)
    low = whole.vertices[whole.vertices[:, 2] < FOOT_MM + 2.0]
    assert np.linalg.norm(low[:, :2], axis=1).max() < 18.0 and whole.vertices[:, 2].min() > FOOT_MM - 0.2


def test_only_the_underside_is_unseen(closed):
    _, _, unseen = closed
    centres = unseen.vertices[unseen.faces].mean(1)
    assert len(centres) > 10 and centres[:, 2].max() < FOOT_MM + 3.0


def test_a_few_small_holes_are_filled_and_nothing_else_changes(views):
    mesh, underside = close_underside(without_faces(ball(), side(), 3.0), UP, FOOT_MM)
    filled = fill_small_holes(mesh, underside, views)
    assert filled is not None
    whole, record = filled
    assert record.watertight and as_trimesh(whole).is_watertight and as_trimesh(whole).is_winding_consistent
    assert np.array_equal(whole.faces[: underside.first_face], mesh.faces[: underside.first_face])
    assert record.faces == underside.faces, "photos see the filled hole"


def test_nothing_is_closed_far_below_what_was_measured(monkeypatch):
    monkeypatch.setattr(watertight, "COARSE", 48)  # a twentieth of the voxels: a block needs no more
    monkeypatch.setattr(watertight, "FINE", 96)
    block = trimesh.creation.box((40.0, 40.0, 30.0)).subdivide().subdivide().subdivide().subdivide()
    mesh = Mesh(np.array(block.vertices), np.array(block.faces)).with_normals()
    steep = [camera_at(f"{k}.png", 60.0 * k, 50.0, 200.0) for k in range(6)]
    seen = [MemoryView(camera, Path(camera.name), None, MeshRenderer(mesh).cast_rays(camera).mask) for camera in steep]
    torn = without_faces(mesh, np.array([0.0, 0.0, -15.0]), 29.0)
    height = {"up": UP.tolist(), "bottom": float(torn.vertices[:, 2].min())}
    assert find_floor(torn, height | {"up_uncertainty": {"roll_certainty": 0.5}}) is None
    floor = find_floor(torn, height | {"up_uncertainty": {"roll_certainty": 0.99}})
    bounded, _ = close_in_space(torn, seen, floor, MAX_FACES)
    free, _ = close_in_space(torn, seen, None, MAX_FACES)
    lowest = torn.vertices[:, 2].min()
    assert as_trimesh(bounded).is_watertight
    assert lowest - bounded.vertices[:, 2].min() < 0.8 and lowest - free.vertices[:, 2].min() < 0.8


def test_wide_holes_are_left_to_the_closing_in_space(views):
    mesh, underside = close_underside(without_faces(ball(), side(), 20.0), UP, FOOT_MM)
    assert fill_small_holes(mesh, underside, views) is None


@pytest.mark.parametrize(
    ("options", "up_source", "state", "method"),
    [
        ({}, "support_plane", "closed", "flat"),
        ({"underside": "open"}, "support_plane", "open", "none"),
        ({"holes": "open"}, "camera_roll", "open", "none"),
    ],
)
def test_it_says_what_was_closed(views, options, up_source, state, method):
    height = {"up": [0.0, 0.0, 1.0], "bottom": FOOT_MM, "up_source": up_source, "up_uncertainty": {}}
    _, facts = close_mesh(ball(), height, views, Closing(**options))
    assert facts["underside"]["state"] == state and facts["underside"]["seen"] is False and facts["closing"]["method"] == method
    assert facts["closing"]["watertight"] == (state == "closed")


def test_a_part_that_holds_no_measured_surface_is_no_part_of_the_object():
    occupied = np.zeros((20, 20, 20), bool)
    occupied[2:6, 2:6, 2:6] = occupied[2:4, 14:18, 2:6] = True  # two parts that were measured
    occupied[8:18, 8:18, 8:18] = True  # and one, larger, where no photo looks
    measured = np.nonzero(occupied & (np.indices(occupied.shape)[0] < 7))
    kept = watertight._keep_measured_parts(occupied, measured)
    assert np.array_equal(kept, occupied & (np.indices(occupied.shape)[0] < 7))
    assert np.array_equal(watertight._keep_measured_parts(occupied, (np.zeros(0, int),) * 3), occupied)


@pytest.fixture(scope="module")
def relief():
    """A wavy plate, seen from one side from so near that it leaves every photo."""
    side = np.linspace(-20.0, 20.0, 61)
    x, z = np.meshgrid(side, side)
    plate = trimesh.Trimesh(np.stack([x, 2.0 * np.sin(x / 4.0) * np.cos(z / 5.0), z], -1).reshape(-1, 3), _grid_faces(61), process=False)
    return Mesh(np.array(plate.vertices), np.array(plate.faces)).with_normals()


def _grid_faces(count: int) -> np.ndarray:
    first = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    return np.concatenate([np.stack([first, first + 1, first + count], 1), np.stack([first + 1, first + count + 1, first + count], 1)])


def test_what_no_mask_bounds_does_not_swell(relief, monkeypatch):
    monkeypatch.setattr(watertight, "COARSE", 64)
    monkeypatch.setattr(watertight, "FINE", 128)
    towards = -1.0 if relief.face_normals()[:, 1].mean() < 0 else 1.0
    seen = [camera_at(f"{k}.png", towards * 90.0 + turn, up, 120.0) for k, (turn, up) in enumerate([(-25, 0), (0, 0), (25, 0), (0, 20)])]
    views = [MemoryView(camera, Path(camera.name), None, np.ones((camera.height_px, camera.width_px), bool)) for camera in seen]
    solid = watertight.close_surface(relief, views, None)
    depth_mm = np.ptp(solid.vertices, axis=0)[1]
    assert as_trimesh(solid).is_watertight
    assert depth_mm < 8.0, "a relief of 4 mm becomes a plate, and not a block of 40"
