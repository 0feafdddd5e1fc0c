"""Where few sparse points lie on the ground, as on a plain table, chance planes through other things must not become the support."""

import numpy as np
import pytest

from helpers.carton_scene import SIZE_MM
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.support.ground_plane import find_background_points, fit_support_plane
from zeroshop_steps.height.object_pose import measure_object_pose

BOTTOM_MM = -SIZE_MM[2] / 2


@pytest.fixture(scope="module")
def scene(carton):
    views, model = read_views(carton.cameras)
    return carton.mesh, views, model


def scatter_on_plane(count: int, height_mm: float, tilt_deg: float = 0.0, centre_x_mm: float = 90.0) -> np.ndarray:
    """(count, 3) points on a small patch beside the carton, inclined about its own y axis."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-40, 40, (2, count))
    slope = np.tan(np.radians(tilt_deg))
    return np.stack([x + centre_x_mm, y, height_mm + slope * (x + centre_x_mm)], 1) + rng.normal(0, 0.1, (count, 3))


def test_a_few_points_that_are_not_level_are_no_ground(scene):
    mesh, views, model = scene
    tilted = scatter_on_plane(60, BOTTOM_MM, tilt_deg=14.0)
    assert fit_support_plane(tilted, mesh.vertices, views) is None
    level = fit_support_plane(scatter_on_plane(60, BOTTOM_MM, tilt_deg=3.0), mesh.vertices, views)
    assert level is not None and np.degrees(np.arccos(level.normal[2])) == pytest.approx(3.0, abs=0.5)


def test_the_plane_on_which_views_agreed_is_taken_where_there_are_few_points(scene):
    mesh, views, model = scene
    normal = np.array([0.0, np.sin(0.01), np.cos(0.01)])
    record = {"plane_from": "views", "plane": {"normal": normal.tolist(), "offset": BOTTOM_MM - 2.0}}
    pose = measure_object_pose(mesh, views, model, record)
    assert pose.bottom == BOTTOM_MM - 2.0 and pose.up == pytest.approx(normal)
    assert pose.extent == pytest.approx(SIZE_MM[2] + 2.0, abs=1.0) and pose.deviation > 0.5
    guessed = measure_object_pose(mesh, views, model, {"plane_from": "object", "plane": record["plane"]})
    assert guessed.plane is None and guessed.extent == pytest.approx(SIZE_MM[2], abs=0.5), "a guess below the object is no measure"
    fitted = measure_object_pose(mesh, views, model, {"plane_from": "points", "plane": record["plane"]})
    given = measure_object_pose(mesh, views, model)
    assert fitted.plane is not None and given.plane is not None and fitted.bottom == given.bottom != record["plane"]["offset"]
    assert find_background_points(model.points, views).sum() > 200
