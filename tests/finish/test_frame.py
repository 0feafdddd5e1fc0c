from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from helpers.carton_scene import SIZE_MM, camera_at
from zeroshop_steps.finish.frame import compute_object_frame, make_frame_record
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.support.ground_plane import SupportPlane, estimate_up_from_roll, find_background_points, fit_support_plane
from zeroshop_steps.height.object_pose import measure_above_plane
from zeroshop_steps.height.record import Scale, describe_height

HEIGHT_M = SIZE_MM[2] / 1000


@pytest.fixture(scope="module")
def scene(carton):
    views, model = read_views(carton.cameras)
    return carton.mesh, views, model.points[find_background_points(model.points, views)]


def moved(similarity: np.ndarray, mesh: Mesh, views: list[View], points: np.ndarray):
    linear, shift = similarity[:3, :3], similarity[:3, 3]
    turned = [replace(view, camera=transform_camera(view.camera, similarity)) for view in views]
    return Mesh(mesh.vertices @ linear.T + shift, mesh.faces), turned, points @ linear.T + shift


def frame_of(mesh: Mesh, views: list[View], points: np.ndarray, height_m: float | None = HEIGHT_M) -> dict:
    return frame_on(mesh, views, fit_support_plane(points, mesh.vertices, views), height_m)


def frame_on(mesh: Mesh, views: list[View], plane: SupportPlane | None, height_m: float | None = HEIGHT_M) -> dict:
    object_pose = measure_above_plane(mesh, views, plane)
    scale = Scale("known_height", height_m / object_pose.extent, 0.001, {}) if height_m else None
    return compute_object_frame(mesh, views, describe_height(object_pose, scale))


def test_the_frame_of_a_box_on_a_table(scene):
    frame = frame_of(*scene)
    object_from_registration = np.array(frame["object_from_registration"])
    assert frame["up_source"] == "support_plane" and frame["scale"] == "known"
    assert np.abs(object_from_registration - np.eye(4))[:3, :3].max() < 2e-3
    assert np.abs(object_from_registration[:3, 3]).max() < 0.1
    assert frame["up_uncertainty"]["deviation_deg"] < 0.05


def test_a_lid_that_nothing_measured_has_no_say_in_the_height(scene):
    mesh, views, points = scene
    plane = fit_support_plane(points, mesh.vertices, views)
    top = mesh.vertices[:, 2].max()
    lid = trimesh.creation.cone(radius=20.0, height=15.0)
    vertices = np.r_[mesh.vertices, np.array(lid.vertices) + [0, 0, top]]
    faces = np.r_[mesh.faces, np.array(lid.faces) + len(mesh.vertices)]
    quality = np.r_[np.ones(len(mesh.vertices)), np.full(len(lid.vertices), 0.5)]
    whole = measure_above_plane(mesh, views, plane)
    lidded = measure_above_plane(Mesh(vertices, faces, quality=quality), views, plane)
    assert lidded.extent == pytest.approx(whole.extent, rel=1e-3)
    assert lidded.top_of_mesh == pytest.approx(whole.top + 15.0, rel=0.01)
    assert measure_above_plane(Mesh(vertices, faces), views, plane).extent > 1.1 * whole.extent, "without evidence all of it counts"
    nothing = measure_above_plane(Mesh(vertices, faces, quality=np.full(len(vertices), 0.5)), views, plane)
    assert nothing.top == nothing.top_of_mesh, "where nothing was measured the mesh is all there is"


@pytest.mark.slow
@given(
    rotation=st.tuples(*[st.floats(-1, 1) for _ in range(4)]).filter(lambda q: np.linalg.norm(q) > 0.1),
    log_scale=st.floats(-4, 4),
    shift=st.tuples(*[st.floats(-50, 50) for _ in range(3)]),
)
@settings(max_examples=12, deadline=None)
def test_the_object_frame_does_not_depend_on_the_registration_frame(scene, rotation, log_scale, shift):
    similarity = np.eye(4)
    similarity[:3, :3] = np.exp(log_scale) * Rotation.from_quat(rotation).as_matrix()
    similarity[:3, 3] = shift
    expected = np.array(frame_of(*scene)["object_from_registration"])
    found = np.array(frame_of(*moved(similarity, *scene))["object_from_registration"]) @ similarity
    assert np.abs(found - expected).max() < 1e-4


def test_unevenly_spread_tilted_cameras_do_not_tilt_the_frame(scene):
    mesh, views, points = scene
    cameras = [camera_at(f"{k:06d}.png", 12.0 * k, 50.0 - 4.0 * k) for k in range(6)]  # one side only, mostly from above
    uneven = [replace(view, camera=camera) for view, camera in zip(views, cameras, strict=False)]
    z = np.array(frame_of(mesh, uneven, points)["object_from_registration"])[2, :3]
    assert np.degrees(np.arccos(z[2] / np.linalg.norm(z))) < 0.1


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 50.0])
@pytest.mark.parametrize("azimuths_deg", [(0, 5, 10, 40, 200), (300, 310, 320, 325), (10, 100, 190, 280)])
def test_the_frame_of_an_odd_shape_from_tilted_and_uneven_cameras(scene, tilt_deg, azimuths_deg):
    """Cameras rolled about their axes, at uneven azimuths and heights: only the plane and the first camera's place count."""
    _, views, points = scene
    rng = np.random.default_rng(3)
    vertices = np.array([[-30, -20, -45], [30, -20, -45], [5, 25, -45], [12, 3, 45.0]]) + [4.0, -6.0, 0.0]
    shape = Mesh(vertices, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]))
    cameras = []
    for k, azimuth_deg in enumerate(azimuths_deg):
        camera = camera_at(f"{k:06d}.png", azimuth_deg, rng.uniform(5.0, 70.0))
        roll = np.eye(4)
        roll[:3, :3] = Rotation.from_euler("z", rng.uniform(-tilt_deg, tilt_deg), degrees=True).as_matrix()
        cameras.append(replace(camera, camera_from_world=roll @ camera.camera_from_world))
    uneven = [replace(view, camera=camera) for view, camera in zip(views, cameras, strict=False)]
    similarity = np.eye(4)
    similarity[:3, :3] = 0.02 * Rotation.from_euler("xyz", [40, -75, 160], degrees=True).as_matrix()
    similarity[:3, 3] = [3.0, -1.0, 7.0]
    turned, turned_views, turned_points = moved(similarity, shape, uneven, points)
    object_from_registration = np.array(frame_of(turned, turned_views, turned_points)["object_from_registration"])
    product = turned.vertices @ object_from_registration[:3, :3].T + object_from_registration[:3, 3]
    assert np.linalg.det(object_from_registration[:3, :3]) > 0, "right-handed"
    assert product.max(0) == pytest.approx(-product.min(0), abs=1e-6), "origin at the middle of the box"
    assert product[3, 2] - product[:3, 2].mean() == pytest.approx(90.0, abs=0.3) and np.ptp(product[:3, 2]) < 0.3, "z up"
    towards = transform_camera(turned_views[0].camera, object_from_registration).centre_in_world
    assert abs(towards[1]) < 1e-4 * towards[0], "x towards the first camera"


def test_a_wall_behind_the_object_is_not_its_support(scene):
    mesh, views, points = scene
    rng = np.random.default_rng(2)
    wall = rng.uniform(-150.0, 150.0, (1500, 3))
    wall[:, 1] = SIZE_MM[1] / 2 + 1.0  # it touches the object, and more points lie on it than on the table
    front = [replace(view, camera=camera_at(f"{k:06d}.png", -120.0 + 10.0 * k, 25.0)) for k, view in enumerate(views[:7])]
    plane = fit_support_plane(np.concatenate([points, wall]), mesh.vertices, front)
    assert plane is not None and plane.normal[2] > 0.999


def test_without_a_plane_up_comes_from_the_cameras_roll(scene):
    mesh, views, _ = scene
    frame = frame_on(mesh, views, None)
    assert frame["up_source"] == "camera_roll"
    assert np.abs(np.array(frame["object_from_registration"]) - np.eye(4)).max() < 1e-6
    up, certainty = estimate_up_from_roll(views)
    assert up[2] > 0.9999 and certainty > 0.5


def test_too_few_points_give_no_plane(scene):
    mesh, views, points = scene
    assert fit_support_plane(points[:10], mesh.vertices, views) is None
    assert fit_support_plane(np.random.default_rng(0).uniform(-100, 100, (200, 3)), mesh.vertices, views) is None


@pytest.mark.parametrize("height_m", [0.027, 0.09, 0.22])
def test_a_known_height_gives_the_exact_scale(scene, height_m):
    mesh, views, _ = scene
    similarity = np.array(frame_on(mesh, views, None, height_m)["object_from_registration"])
    assert np.ptp((mesh.vertices @ similarity[:3, :3].T)[:, 2]) == pytest.approx(height_m * 1000, rel=1e-9)


def test_a_spike_on_top_does_not_change_the_scale(scene):
    mesh, views, _ = scene
    box = Mesh(mesh.vertices.copy(), mesh.faces)
    tip = np.flatnonzero(box.vertices[:, 2] == box.vertices[:, 2].max())[:1]
    vertices = np.concatenate([box.vertices, box.vertices[tip] + [[0, 0, 8.0], [0.05, 0, 8.0], [0, 0.05, 8.0]]])
    spiked = Mesh(vertices, np.concatenate([box.faces, [[len(vertices) - 3, len(vertices) - 2, len(vertices) - 1]]]))
    frame = frame_on(spiked, views, None)
    assert frame["height_in_registration"] == pytest.approx(SIZE_MM[2], rel=1e-6)


def test_an_unknown_scale_is_kept_as_it_is(scene, tmp_path):
    mesh, views, _ = scene
    frame = make_frame_record(mesh, views, describe_height(measure_above_plane(mesh, views, None), None), tmp_path)
    assert frame["scale"] == frame["scale_source"] == "unknown" and frame["unit"] == "registration"
    assert np.linalg.det(np.array(frame["object_from_registration"])) == pytest.approx(1.0)


def turn_a_quarter(view, sign=1):
    camera = view.camera
    quarter = np.array([[0.0, -sign, 0, 0], [sign, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return replace(
        view,
        camera=replace(camera, width_px=camera.height_px, height_px=camera.width_px, camera_from_world=quarter @ camera.camera_from_world),
    )


def test_photos_that_are_stored_on_their_side_do_not_tip_up_over(scene):
    _, views, _ = scene
    turned = [turn_a_quarter(view) if number % 3 == 0 else view for number, view in enumerate(views)]
    assert views[0].camera.width_px != views[0].camera.height_px
    up, certainty = estimate_up_from_roll(turned)
    assert up[2] > 0.9999 and certainty > 0.5


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("elevation_deg", [10.0, 30.0, 60.0])
@pytest.mark.parametrize("arc_deg", [210.0, 360.0])
def test_all_photos_may_be_stored_on_their_side_and_none_are_where_they_are_held_level(scene, arc_deg, elevation_deg, sign):
    _, views, _ = scene
    azimuths_deg = np.linspace(0.0, arc_deg, 12, endpoint=False)
    held = [replace(views[0], camera=camera_at(f"{k:06d}.png", azimuth, elevation_deg)) for k, azimuth in enumerate(azimuths_deg)]
    for photos in (held, [turn_a_quarter(view, sign) for view in held]):
        up, certainty = estimate_up_from_roll(photos)
        assert up[2] > 0.9999 and certainty > 0.4
