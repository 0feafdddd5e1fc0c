"""Plain hollows of vessels are opened where photos tell the inside, and nothing else is."""

from collections.abc import Iterator

import numpy as np
import pytest

from helpers.shaded_vessel import (
    FLOOR_MM,
    HEIGHT_MM,
    RADIUS_MM,
    UP,
    WALL_MM,
    Paint,
    glazed,
    glossy,
    matt,
    mug,
    photograph,
    shaded,
)
from zeroshop_steps.finish.closing import hollows, vessel
from zeroshop_steps.finish.closing.hollows import Hollow, open_hollow
from zeroshop_steps.finish.closing.underside import find_open_borders
from zeroshop_steps.geometry.alignment.surface_distance import measure_distances
from zeroshop_steps.geometry.meshes.mass_properties import measure_solid
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

pytestmark = pytest.mark.slow

NOTHING = np.zeros((0, 3))


def opened_from(truth: Mesh, paint: Paint, mesh: Mesh, confirmed: np.ndarray = NOTHING) -> Hollow | None:
    return open_hollow(mesh, photograph(truth, paint), confirmed, UP)


@pytest.fixture(scope="module", autouse=True)
def coarse_voxels() -> Iterator[None]:
    """Voxels of 1.6 mm, as the walls are 5 mm thick; and of each photo, half the pixels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vessel, "COARSE_VOXELS", 56)
        patch.setattr(hollows, "PIXELS", hollows.PIXELS // 2)
        yield


@pytest.fixture(scope="module")
def filled() -> Mesh:
    """What masks alone leave of a mug: filled nearly up to its rim."""
    return mug(hollow_mm=3.0)


@pytest.fixture(scope="module")
def opened(filled: Mesh) -> Hollow:
    found = opened_from(mug(), shaded, filled)
    assert found is not None
    return found


def test_the_wall_is_found_and_the_inside_lies_where_it_is(opened: Hollow):
    assert abs(opened.wall - WALL_MM) < 0.8 and opened.after < 0.5 * opened.before
    wall = opened.mesh.vertices[opened.mesh.faces[opened.origin < 0]].mean(1)
    wall = wall[wall[:, 2] > FLOOR_MM + 4.0 - HEIGHT_MM / 2]
    assert np.quantile(measure_distances(mug(), wall), 0.95) < 1.0
    assert abs(opened.floor - FLOOR_MM) < 2.0


def test_highlights_do_not_hide_the_inside_of_a_coloured_mug(filled: Mesh):
    found = opened_from(mug(), glazed, filled)
    assert found is not None and abs(found.wall - WALL_MM) < 0.8 and found.taper == 0.0


def test_an_opened_mesh_is_closed_and_faces_outwards(opened: Hollow):
    assert not find_open_borders(opened.mesh.faces)
    assert abs(measure_solid(opened.mesh, "mug").volume / measure_solid(mug(), "mug").volume - 1) < 0.2


def test_the_outside_and_the_handle_keep_their_faces(opened: Hollow, filled: Mesh):
    outside = np.flatnonzero(np.hypot(*filled.vertices[filled.faces].mean(1)[:, :2].T) > RADIUS_MM - 0.5)
    kept = {face: corners for face, corners in zip(opened.origin, opened.mesh.vertices[opened.mesh.faces], strict=True) if face >= 0}
    assert all(np.ptp(np.sort(kept[face], axis=0) - np.sort(filled.vertices[filled.faces[face]], axis=0)) < 1e-4 for face in outside)


def test_the_same_inputs_give_the_same_mesh(opened: Hollow, filled: Mesh):
    again = opened_from(mug(), shaded, filled)
    assert again is not None and np.array_equal(again.mesh.vertices, opened.mesh.vertices)
    assert np.array_equal(again.mesh.faces, opened.mesh.faces) and np.array_equal(again.origin, opened.origin)


@pytest.mark.parametrize("paint", [matt, glossy, glazed, shaded])
def test_a_drum_stays_closed(paint: Paint):
    drum = mug(hollow_mm=0.0)
    assert opened_from(drum, paint, drum) is None


def test_a_hollow_that_stereo_measured_otherwise_stays(filled: Mesh):
    """Points all over the lid: it is measured, whatever the colours say."""
    radius, angle = np.meshgrid(np.linspace(0, 33, 30), np.linspace(0, 6.28, 60))
    lid = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(radius.shape, HEIGHT_MM / 2 - 3.0)], -1).reshape(-1, 3)
    assert opened_from(mug(), shaded, filled, lid) is None


def test_a_right_hollow_stays_as_it_is():
    assert opened_from(mug(), shaded, mug()) is None
