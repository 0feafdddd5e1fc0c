"""The map and the planner: what was not seen is wanted, what is hidden is not counted, and enough is enough."""

from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.scan.assumed_surface import AssumedSurface
from zeroshop_steps.scan.cell_visibility import FREE, see_cells
from zeroshop_steps.scan.measured_surface import SURFACE, UNKNOWN, MeasuredSurface
from zeroshop_steps.scan.next_views import Advice, propose
from zeroshop_steps.scan.pinhole_depth import flatten_depth, pinhole_camera
from zeroshop_steps.scan.reach import Limits
from zeroshop_steps.scan.recorder import ScanRecorder
from zeroshop_steps.scan.session import Scan
from zeroshop_steps.scan.viewpoints import ViewSphere
from zeroshop_steps.scan.workspace import Box, Grid

INTRINSICS = np.array([[150.0, 0.0, 80.0], [0.0, 150.0, 60.0], [0.0, 0.0, 1.0]])
CAMERA = Camera("", 160, 120, INTRINSICS, np.eye(4))
BOX = Box(np.array([-0.08, -0.08, 0.0]), np.array([0.08, 0.08, 0.14]))
SPHERE = ViewSphere(CAMERA, directions=80)


def box_mesh(low: tuple[float, ...], high: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (np.array(high) - low) + low
    faces = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
    return corners, np.array(faces)


def world_of(*boxes: tuple[tuple[float, ...], tuple[float, ...]]) -> MeshRenderer:
    """Boxes on a table whose top is z = 0."""
    parts = [box_mesh(*one) for one in (*boxes, ((-1.0, -1.0, -0.05), (1.0, 1.0, 0.0)))]
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts[:-1], strict=True)])
    return MeshRenderer(Mesh(np.concatenate([vertices for vertices, _ in parts]), faces))


BLOCK = world_of(((-0.04, -0.04, 0.0), (0.04, 0.04, 0.1)))


def view(azimuth_deg: float, elevation_deg: float = 35.0, distance_m: float = 0.4) -> np.ndarray:
    centre = np.array([0.0, 0.0, 0.05])
    return np.linalg.inv(look_at(centre + distance_m * direction_at(np.radians(azimuth_deg), np.radians(elevation_deg)), centre))


def look(surface: MeasuredSurface, world: MeshRenderer, *views: np.ndarray) -> None:
    for one in views:
        camera = SPHERE.camera_at(one)
        surface.add_view(camera, world.find_depth(camera))


def state_at(surface: MeasuredSurface, *points: tuple[float, float, float]) -> list[int]:
    cells = np.floor((np.array(points) - surface.grid.low_m) / surface.grid.cell_m).astype(int)
    return [int(surface.states[tuple(cell)]) for cell in cells]


def test_a_view_makes_free_what_it_looks_through_and_leaves_unknown_what_is_behind() -> None:
    surface = MeasuredSurface(BOX, cells=48)
    look(surface, BLOCK, view(0, 30))
    assert state_at(surface, (0.06, 0.0, 0.06), (0.041, 0.0, 0.05), (0.0, 0.0, 0.05), (-0.06, 0.0, 0.03)) == [
        FREE,
        SURFACE,
        UNKNOWN,
        UNKNOWN,
    ]


def test_the_unseen_side_gains_most() -> None:
    surface = MeasuredSurface(BOX, cells=48)
    look(surface, BLOCK, view(0))
    again, back, aside = surface.gains([SPHERE.camera_at(view(azimuth)) for azimuth in (0, 180, 90)])
    assert min(back, aside) > 3 * again
    # The proposal looks at the back, whatever else it sees.
    advice = propose(surface, SPHERE, Limits(), [view(0)])
    assert advice.proposals and advice.proposals[0].move.world_from_camera[0, 3] < -0.1
    assert not advice.enough and "the best view adds" in advice.reason


def scan_until_enough(surface: MeasuredSurface, world: MeshRenderer) -> tuple[list[np.ndarray], Advice]:
    taken: list[np.ndarray] = []
    while len(taken) < 25:
        advice = propose(surface, SPHERE, Limits(), taken)
        if advice.enough:
            return taken, advice
        taken.append(advice.proposals[0].move.world_from_camera)
        look(surface, world, taken[-1])
    raise AssertionError("it is never enough")


def test_it_is_enough_after_all_sides_and_not_after_one_view() -> None:
    surface = MeasuredSurface(BOX, cells=48)
    assert not propose(surface, SPHERE, Limits(), []).enough
    taken, advice = scan_until_enough(surface, BLOCK)
    assert 3 <= len(taken) <= 10 and "enough" in advice.reason
    sides = [(0.039, 0.0, 0.05), (-0.039, 0.0, 0.05), (0.0, 0.039, 0.05), (0.0, -0.039, 0.05), (0.0, 0.0, 0.099)]
    assert state_at(surface, *sides) == [SURFACE] * 5
    assert advice.coverage.well_seen > 0.9


def test_more_views_are_wanted_where_photos_need_them() -> None:
    once, thrice = MeasuredSurface(BOX, 1, cells=48), MeasuredSurface(BOX, 3, cells=48)
    fewer, _ = scan_until_enough(once, BLOCK)
    more, advice = scan_until_enough(thrice, BLOCK)
    assert len(more) > len(fewer) and advice.coverage.well_seen > 0.8


def test_what_is_hidden_from_all_sides_is_looked_into() -> None:
    # A tray of four walls: its floor is seen from steep above alone.
    walls = [((-0.05, -0.05, 0.0), (-0.04, 0.05, 0.1)), ((0.04, -0.05, 0.0), (0.05, 0.05, 0.1))]
    walls += [((-0.05, -0.05, 0.0), (0.05, -0.04, 0.1)), ((-0.05, 0.04, 0.0), (0.05, 0.05, 0.1)), ((-0.05, -0.05, 0.0), (0.05, 0.05, 0.01))]
    tray, surface = world_of(*walls), MeasuredSurface(BOX, cells=48)
    look(surface, tray, *(view(azimuth, 12) for azimuth in range(0, 360, 45)))
    advice = propose(surface, SPHERE, Limits(), [view(azimuth, 12) for azimuth in range(0, 360, 45)])
    height = advice.proposals[0].move.world_from_camera[2, 3]
    assert not advice.enough and height > 0.25


def test_a_second_eye_that_sees_nothing_gains_nothing() -> None:
    near, far = (MeasuredSurface(BOX, cells=32, second_eye_m=np.array([shift, 0.0, 0.0])) for shift in (0.0, 5.0))
    look(near, BLOCK, view(0))
    look(far, BLOCK, view(0))
    camera = [SPHERE.camera_at(view(180))]
    assert far.gains(camera)[0] < 0.8 * near.gains(camera)[0]


def test_a_frontier_that_cannot_be_measured_is_given_up() -> None:
    surface = MeasuredSurface(BOX, cells=32)
    dark = np.zeros((120, 160), np.float32)
    for azimuth in range(0, 360, 30):
        for elevation in (20, 50, 80):
            surface.add_view(SPHERE.camera_at(view(azimuth, elevation)), dark)
    assert surface.coverage().unknown == 0


def test_what_is_out_of_reach_is_not_proposed() -> None:
    surface = MeasuredSurface(BOX, cells=32)
    look(surface, BLOCK, view(0))
    limits = Limits(base_m=np.array([0.5, 0.0, 0.0]), reach_m=0.55)
    advice = propose(surface, SPHERE, limits, [view(0)])
    assert advice.proposals
    assert all(np.linalg.norm(one.move.world_from_camera[:3, 3] - limits.base_m) <= 0.55 for one in advice.proposals)
    assert propose(surface, SPHERE, Limits(lowest_m=2.0), [view(0)]).proposals == ()


def test_of_views_that_gain_alike_the_nearest_is_first() -> None:
    surface = MeasuredSurface(BOX, cells=32)
    here = view(100, 60)
    advice = propose(surface, SPHERE, Limits(world_from_camera=here), [])
    best = max(one.gain for one in advice.proposals)
    alike = [one.move.cost for one in advice.proposals if one.gain >= 0.85 * best]
    assert advice.proposals[0].move.cost == alike[0] and alike == sorted(alike) and len(alike) > 1


def test_a_refused_view_is_not_proposed_again() -> None:
    surface = MeasuredSurface(BOX, cells=32)
    look(surface, BLOCK, view(0))
    first = propose(surface, SPHERE, Limits(), [view(0)]).proposals[0].move.world_from_camera
    second = propose(surface, SPHERE, Limits(), [view(0)], [first]).proposals[0].move.world_from_camera
    assert np.linalg.norm(first[:3, 3] - second[:3, 3]) > 0.03


def test_an_empty_box_is_never_enough() -> None:
    surface = MeasuredSurface(Box(np.array([0.3, 0.3, 0.0]), np.array([0.4, 0.4, 0.1])), cells=32)
    views = [np.linalg.inv(look_at(np.array([x, y, 0.4]), np.array([0.35, 0.35, 0.0]))) for x in (0.0, 0.7) for y in (0.0, 0.7)]
    look(surface, BLOCK, *views)
    advice = propose(surface, SPHERE, Limits(), views)
    assert not advice.enough and "no surface was measured in the box" in advice.reason


def test_without_depth_all_sides_of_the_box_are_wanted_three_times() -> None:
    surface, taken = AssumedSurface(BOX, 3), []
    while not (advice := propose(surface, SPHERE, Limits(), taken)).enough:
        taken.append(advice.proposals[0].move.world_from_camera)
        surface.add_view(SPHERE.camera_at(taken[-1]), None)
        assert len(taken) < 30
    assert 6 <= len(taken) <= 20 and advice.coverage.well_seen > 0.9
    azimuths = np.degrees(np.arctan2(*np.array(taken)[:, [1, 0], 3].T))
    assert {int(azimuth // 90) for azimuth in azimuths} == {-2, -1, 0, 1}


def test_visibility_is_that_of_a_slow_twin() -> None:
    rng = np.random.default_rng(0)
    states = np.where(rng.random((12, 10, 8)) < 0.9, FREE, SURFACE).astype(np.uint8)
    grid = Grid(np.array([-0.06, -0.05, 0.0]), 0.01, states.shape)
    targets = rng.uniform([-0.06, -0.05, 0.0], [0.06, 0.05, 0.08], (60, 3))
    normals = np.tile([0.0, 0.0, 1.0], (60, 1))
    camera = SPHERE.camera_at(view(30, 50))
    found = see_cells(states, grid.low_m, grid.cell_m, targets, normals, 0.1, [camera])[0]
    for target, seen in zip(targets, found, strict=True):
        direction = camera.centre_in_world - target
        steps = target + np.arange(1.8, 40.0)[:, None] * grid.cell_m * direction / np.linalg.norm(direction)
        cells = np.floor((steps - grid.low_m) / grid.cell_m).astype(int)
        inside = ((cells >= 0) & (cells < states.shape)).all(1)
        first_out = int(np.argmin(inside)) if not inside.all() else len(inside)
        free = all(states[tuple(cell)] == FREE for cell in cells[:first_out])
        assert seen == (free and camera.find_pixels(target[None])[3][0])
    assert 5 < found.sum() < 55


def test_depth_of_a_lens_with_distortion_is_flattened() -> None:
    lens = Lens("OPENCV", 160, 120, (150.0, 150.0, 80.0, 60.0, -0.3, 0.1, 0.0, 0.0))
    rows, columns = np.mgrid[0:120, 0:160] + 0.5
    distorted = (1.0 + 0.01 * columns + 0.02 * rows).astype(np.float32)
    flat = flatten_depth(lens, distorted)
    (place,) = lens.to_colmap().img_from_cam(np.array([[(20.5 - 80) / 150, (15.5 - 60) / 150, 1.0]]))
    assert flat[15, 20] == pytest.approx(1.0 + 0.01 * place[0] + 0.02 * place[1], abs=0.02)
    assert abs(flat[15, 20] - distorted[15, 20]) > 0.02
    np.testing.assert_allclose(pinhole_camera(lens, np.eye(4)).intrinsics, INTRINSICS)


def test_a_scan_is_continued_with_its_map(tmp_path: Path) -> None:
    lens = Lens.pinhole(INTRINSICS, (160, 120))
    photo = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    scan = Scan(ScanRecorder(tmp_path / "scan", "arm"), MeasuredSurface(BOX, cells=32), SPHERE)
    for azimuth in (0, 120):
        scan.record(photo, BLOCK.find_depth(SPHERE.camera_at(view(azimuth))), lens, view(azimuth))
    again = Scan(ScanRecorder(tmp_path / "scan", "arm"), MeasuredSurface(BOX, cells=32), SPHERE)
    (first, other) = (one.propose(Limits()) for one in (scan, again))
    assert again.surface.coverage() == scan.surface.coverage()
    np.testing.assert_allclose(first.proposals[0].move.world_from_camera, other.proposals[0].move.world_from_camera, atol=1e-6)


@pytest.mark.parametrize("size", [(100.0, 100.0, 200.0), (0.1, 0.0, 0.1), (0.1, np.nan, 0.1)])
def test_a_box_that_is_none_is_refused(size: tuple[float, float, float]) -> None:
    with pytest.raises(StepError, match="metres, not millimetres"):
        Box.around(np.zeros(3), np.array(size))
