"""Bodies whose stable placements, volume and inertia are known in closed form."""

import numpy as np
import pytest
import trimesh

from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.meshes.mass_properties import measure_solid
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.support.placements import Placement, placements_of_hull
from zeroshop_steps.runtime.errors import StepError


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int64))


def find_placements(mesh: Mesh) -> list[Placement]:
    return placements_of_hull(mesh.vertices, measure_solid(mesh, "body").centre)


def test_volume_and_inertia_of_a_box_off_the_origin():
    box = measure_solid(mesh_of(trimesh.creation.box((60, 40, 20)).apply_translation((7, -3, 11))), "box")
    mass = 0.3
    assert np.isclose(box.volume, 60 * 40 * 20) and np.allclose(box.centre, (7, -3, 11))
    assert np.allclose(box.inertia_of(mass), np.diag([40**2 + 20**2, 60**2 + 20**2, 60**2 + 40**2]) * mass / 12)


def test_volume_and_inertia_of_a_cylinder():
    radius, height, mass = 30.0, 120.0, 0.5
    found = measure_solid(mesh_of(trimesh.creation.cylinder(radius, height, sections=128)), "cylinder")
    assert np.isclose(found.volume, np.pi * radius**2 * height, rtol=0.01)
    across = mass * (3 * radius**2 + height**2) / 12
    assert np.allclose(found.inertia_of(mass), np.diag([across, across, mass * radius**2 / 2]), rtol=0.01, atol=1.0)


def test_a_texture_seam_does_not_open_a_solid():
    box = trimesh.creation.box((60, 40, 20))
    split = Mesh(np.asarray(box.triangles, float).reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert np.isclose(measure_solid(split, "box").volume, 60 * 40 * 20)


def test_an_open_mesh_and_one_turned_inside_out_are_refused():
    box = mesh_of(trimesh.creation.box((60, 40, 20)))
    with pytest.raises(StepError, match=r"a\.ply is open \(4 edges .*finish: \{underside: closed"):
        measure_solid(Mesh(box.vertices, box.faces[(box.face_normals()[:, 2] < 0.5)]), "a.ply")
    with pytest.raises(StepError, match="inside out"):
        measure_solid(Mesh(box.vertices, box.faces[:, ::-1]), "a.ply")


def test_a_box_rests_on_each_of_its_faces():
    size = np.array([60.0, 40.0, 20.0])
    mesh = mesh_of(trimesh.creation.box(size).apply_translation((5, 5, 5)))
    found = find_placements(mesh)
    assert [placement.kind for placement in found] == ["upright", "flipped"] + 4 * ["lying"] or [placement.kind for placement in found] == [
        "flipped",
        "upright",
    ] + 4 * ["lying"]
    assert np.isclose(sum(placement.probability for placement in found), 1)
    flat = found[0]
    # The solid angle of a rectangle seen from above its middle, over the whole sphere.
    a, b, h = 30.0, 20.0, 10.0
    angle = 4 * np.arctan(a * b / (h * np.sqrt(a**2 + b**2 + h**2)))
    # A thrown box that lands on another face may topple on to this one, so it is at least as likely.
    assert flat.probability >= angle / (4 * np.pi) - 1e-6 and np.isclose(flat.probability, found[1].probability, atol=1e-6)
    assert np.isclose(flat.stability_deg, np.degrees(np.arctan2(20, 10)), atol=0.1)
    for placement in found:
        placed = transform_points(mesh.vertices, placement.plane_from_object)
        assert np.isclose(placed[:, 2].min(), 0, atol=1e-9) and (np.abs(placed[:, 2]) < 1e-6).sum() == 4
        assert np.allclose(transform_points(np.full((1, 3), 5.0), placement.plane_from_object)[0, :2], 0, atol=1e-9)
        assert np.isclose(np.linalg.det(placement.plane_from_object[:3, :3]), 1)
    upright = next(placement for placement in found if placement.kind == "upright")
    assert np.allclose(upright.plane_from_object[:3, :3], np.eye(3)), "no turn that is not needed"


def test_a_tall_can_with_a_rough_base_still_stands():
    can = trimesh.creation.cylinder(30, 100, sections=64)
    rough = mesh_of(can.subdivide().subdivide())
    noise = np.random.default_rng(0).normal(scale=0.1, size=rough.vertices.shape)
    found = find_placements(Mesh(rough.vertices + noise, rough.faces))
    kinds = {kind: sum(placement.probability for placement in found if placement.kind == kind) for kind in ("upright", "flipped", "lying")}
    assert abs(kinds["upright"] - kinds["flipped"]) < 0.03 and kinds["lying"] > 0.5
    assert sum(placement.kind == "upright" for placement in found) == 1, "the dents of its base are one placement"


def test_what_cannot_stand_does_not():
    cone = trimesh.creation.cone(40, 20, sections=64)
    found = find_placements(mesh_of(cone))
    assert {placement.kind for placement in found} == {"upright", "lying"} or {placement.kind for placement in found} == {"upright"}
