"""How a model is put down the second time."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.geometry.placements import Placement
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.synthetic import turned_model
from zeroshop_steps.synthetic.turned_model import choose_second_placement, is_another


def mesh_of(body: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(body.vertices, float), np.asarray(body.faces))


def test_a_box_is_turned_upside_down():
    placement = choose_second_placement(mesh_of(trimesh.creation.box((40, 60, 90))), "box")
    assert placement.kind == "flipped" and np.allclose(placement.plane_from_object[2, :3], [0, 0, -1])


def test_a_cone_that_cannot_stand_on_its_tip_lies():
    assert choose_second_placement(mesh_of(trimesh.creation.cone(30, 100)), "cone").kind == "lying"


def placement(tilt_deg: float, stability_deg: float) -> Placement:
    plane_from_object = np.eye(4)
    plane_from_object[:3, :3] = Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix()
    return Placement(plane_from_object, 0.5, stability_deg)


@pytest.mark.parametrize(
    ("tilt_deg", "stability_deg", "another"), [(0, 60, False), (30, 60, False), (90, 1, True), (180, 60, True), (180, 2, False)]
)
def test_upside_down_counts_where_it_does_not_fall_over(tilt_deg, stability_deg, another):
    assert is_another(placement(tilt_deg, stability_deg)) == another


def test_a_body_that_rests_in_one_way_only_has_no_second_pass(monkeypatch):
    monkeypatch.setattr(turned_model, "placements_of_hull", lambda vertices, centre: [placement(0, 60)])
    with pytest.raises(StepError, match="dome.ply rests in one way only"):
        choose_second_placement(mesh_of(trimesh.creation.box((1, 1, 1))), "dome.ply")
