"""The unseen underside: closed flat in the support plane, marked, and without effect on what is measured."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from helpers.carton_scene import SIZE_MM
from helpers.solids import as_trimesh
from zeroshop_steps.finish.closing.underside import close_underside, drop_underside, find_open_borders
from zeroshop_steps.finish.texture import bake_texture
from zeroshop_steps.finish.texturing.unwrap import unwrap_mesh
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.meshes.surface_fields import weld
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

UP = np.array([0.0, 0.0, 1.0])


def open_below(mesh: trimesh.Trimesh, cut_z: float) -> Mesh:
    """The part of a closed mesh above `cut_z`."""
    vertices, faces, _ = trimesh.intersections.slice_faces_plane(mesh.vertices, mesh.faces, np.array([0, 0, 1.0]), np.array([0, 0, cut_z]))
    cut = trimesh.Trimesh(vertices, faces)
    return Mesh(np.array(cut.vertices), np.array(cut.faces)).without_loose_vertices()


def shapes() -> dict[str, Mesh]:
    """Objects that stand on z = 0, open below."""
    cylinder = trimesh.creation.cylinder(30.0, 80.0, sections=48).subdivide().subdivide()
    cylinder.apply_translation([0, 0, 40])
    ring = trimesh.creation.torus(40.0, 12.0, major_sections=64, minor_sections=32)
    ring.apply_translation([0, 0, 11.0])
    ball = trimesh.creation.icosphere(4, 30.0)
    ball.apply_translation([0, 0, 28.0])
    legs = trimesh.util.concatenate([trimesh.creation.cylinder(5.0, 40.0, sections=24).subdivide() for _ in range(3)])
    for number in range(3):
        start = number * len(legs.vertices) // 3
        legs.vertices[start : start + len(legs.vertices) // 3] += [30.0 * number, 10.0 * number**2, 20.0]
    return {
        "cylinder": open_below(cylinder, 1.0),
        "ring": open_below(ring, 1.5),
        "ball": open_below(ball, 1.0),
        "three legs": open_below(legs, 1.0),
    }


@pytest.mark.parametrize("name", shapes())
def test_an_open_underside_is_closed_flat(name):
    mesh = shapes()[name]
    whole, underside = close_underside(mesh, UP, 0.0)
    assert find_open_borders(mesh.faces) and not find_open_borders(whole.faces)
    assert underside.watertight and as_trimesh(whole).is_watertight and as_trimesh(whole).is_winding_consistent
    assert underside.borders == {"cylinder": 1, "ring": 2, "ball": 1, "three legs": 3}[name]
    assert as_trimesh(whole).volume > 0
    added = whole.faces[underside.first_face :]
    assert np.array_equal(whole.faces[: underside.first_face], mesh.faces)
    assert np.array_equal(whole.vertices[: len(mesh.vertices)], mesh.vertices)
    fresh = whole.vertices[len(mesh.vertices) :]
    assert np.abs(fresh[:, 2]).max() < 1e-9, "everything new lies in the plane"
    flat = added[(added >= len(mesh.vertices)).all(1)]
    corners = whole.vertices[flat]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] <= 1e-9).all(), "the bottom faces down"


def test_the_area_of_the_bottom_is_that_of_its_border():
    mesh = shapes()["cylinder"]
    whole, underside = close_underside(mesh, UP, 0.0)
    corners = whole.vertices[whole.faces[underside.first_face :]]
    corners = corners[(corners[:, :, 2] < 1e-9).all(1)]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(48 / 2 * 30.0**2 * np.sin(2 * np.pi / 48), rel=2e-3)


@given(rotation=st.tuples(*[st.floats(-1, 1) for _ in range(4)]).filter(lambda q: np.linalg.norm(q) > 0.1), seed=st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_ragged_borders_in_any_frame_are_closed(rotation, seed):
    mesh = shapes()["cylinder"]
    rng = np.random.default_rng(seed)
    ragged = mesh.vertices + np.where(mesh.vertices[:, 2:] < 3.0, rng.uniform(-1.0, 1.0, mesh.vertices.shape), 0.0)
    turn = Rotation.from_quat(rotation).as_matrix()
    whole, underside = close_underside(Mesh(ragged @ turn.T, mesh.faces), turn @ UP, 0.0)
    assert underside.state == "closed" and underside.watertight and not find_open_borders(whole.faces)


def test_a_hole_in_the_wall_is_no_underside():
    cylinder = trimesh.creation.cylinder(30.0, 80.0, sections=48).subdivide().subdivide()
    cylinder.apply_translation([0, 0, 40])
    faces = np.delete(np.array(cylinder.faces), cylinder.triangles_center[:, 0].argmax(), axis=0)
    mesh = Mesh(np.array(cylinder.vertices), faces)
    same, underside = close_underside(mesh, UP, 0.0)
    assert underside.state == "open" and not underside.watertight and underside.left_open == 1
    assert np.array_equal(same.faces, mesh.faces)


def test_an_outline_that_crosses_itself_is_smoothed_until_it_does_not():
    """The wall of a U, whose lower border winds to and fro: nothing may be spanned between its arms."""
    outline = np.array([[0, 0], [90, 0], [90, 80], [60, 80], [60, 30], [30, 30], [30, 80], [0, 80.0]])
    length = np.r_[0, np.cumsum(np.linalg.norm(np.roll(outline, -1, 0) - outline, axis=1))]
    places = np.linspace(0, length[-1], 600, endpoint=False)
    plan = np.stack([np.interp(places, length, np.r_[outline[:, k], outline[0, k]]) for k in (0, 1)], 1)
    rows = [np.c_[plan, np.full(600, height)] for height in (1.0, 20.0, 40.0)]
    rows[0][:, :2] += np.random.default_rng(0).uniform(-1.5, 1.5, (600, 2))  # points are 0.8 apart
    here, after = np.arange(600), np.roll(np.arange(600), -1)
    faces = [np.concatenate([np.stack([k + here, k + after, k + 600 + after], 1), np.stack([k + here, k + 600 + after, k + 600 + here], 1)])
             for k in (0, 600)]  # fmt: skip
    whole, underside = close_underside(Mesh(np.concatenate(rows), np.concatenate(faces)), UP, 0.0)
    assert underside.state == "closed" and (underside.borders, underside.left_open) == (1, 1), "its upper border stays"
    corners = whole.vertices[whole.faces[underside.first_face :]]
    flat = corners[(np.abs(corners[:, :, 2]) < 1e-9).all(1)]
    areas = np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])[:, 2] / 2
    assert areas.sum() == pytest.approx(-(90 * 80 - 30 * 50), rel=0.01)
    assert areas.max() < 1e-3 * np.abs(areas).sum(), "nothing is covered twice"


def test_a_closed_mesh_stays_as_it_is():
    box = trimesh.creation.box(SIZE_MM)
    same, underside = close_underside(Mesh(np.array(box.vertices), np.array(box.faces)), UP, -SIZE_MM[2] / 2)
    assert (underside.state, underside.faces, underside.watertight) == ("closed", 0, True) and len(same.faces) == 12


def test_without_the_underside_the_mesh_is_what_it_was():
    mesh = shapes()["ball"]
    whole, underside = close_underside(mesh, UP, 0.0)
    seen = drop_underside(whole, {"underside": underside.as_record()})
    assert np.array_equal(seen.vertices, mesh.vertices) and np.array_equal(seen.faces, mesh.faces)
    assert len(drop_underside(whole, {"underside": None}).faces) == len(whole.faces)


def test_the_underside_takes_its_colour_from_its_border(carton):
    box = trimesh.creation.box(SIZE_MM).subdivide().subdivide().subdivide().subdivide()
    mesh = open_below(box, -SIZE_MM[2] / 2 + 1e-6)
    whole, underside = close_underside(mesh, UP, -SIZE_MM[2] / 2)
    mesh, _ = unwrap_mesh(whole, 256)
    assert mesh.uv.min() >= 0.0 and mesh.uv.max() <= 1.0
    joined, index = weld(mesh)
    assert np.array_equal(joined.vertices[index[mesh.faces]], whole.vertices[whole.faces]), "unwrapping keeps the order of the faces"
    views, _ = read_views(carton.cameras)
    texture, _ = bake_texture(mesh, views, 256)
    added = mesh.faces[underside.first_face :]
    places = np.clip(((mesh.uv[added].mean(1)) * [256, -256] + [0, 256]).astype(int), 0, 255)
    colors = texture[places[:, 1], places[:, 0]].astype(float)
    wall = carton.mesh.texture.reshape(-1, 3).astype(float)
    assert (colors.mean(0) > wall.min(0)).all() and (colors.mean(0) < wall.max(0)).all()
    assert colors.std() < wall.std(), "smooth inside"
