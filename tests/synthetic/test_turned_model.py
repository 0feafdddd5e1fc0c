"""How a model is put down the second time."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.geometry.support.placements import Placement
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json
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


def test_a_model_with_colors_at_its_vertices_keeps_them(tmp_path):
    mesh = mesh_of(trimesh.creation.box((40, 60, 90)))
    write_ply(tmp_path / "model.ply", replace(mesh, colors=np.tile(np.array([[200, 30, 60]], np.uint8), (len(mesh.vertices), 1))))
    write_json(tmp_path / "model_info.json", {"name": "box", "diameter": 115.3})
    words = ["--method", "turned_model", "--model", str(tmp_path), "--out", str(tmp_path / "turned")]
    assert stage_main("zeroshop_steps.synthetic", words) == 0
    turned = read_ply(tmp_path / "turned/model.ply")
    assert turned.is_textured and np.abs(turned.texture_image[0, 0].astype(int) - [200, 30, 60]).max() <= 1
