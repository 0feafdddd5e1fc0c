"""Templates show the whole model from all sides, at the pose that they name."""

import numpy as np
import pytest
import trimesh

from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.detect.templates import Templates, make_view_directions, read_templates, render_templates
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError


def box() -> Mesh:
    solid = trimesh.creation.box((90, 60, 30))
    solid.apply_translation((5, -4, 12))
    return Mesh(np.asarray(solid.vertices), np.asarray(solid.faces))


@pytest.mark.parametrize(("views", "apart_deg"), [(42, 37.5), (642, 9.6)])
def test_directions_are_spread_all_over(views, apart_deg):
    directions = make_view_directions(views)
    assert directions.shape == (views, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    cosines = directions @ directions.T - 2 * np.eye(views)
    assert np.degrees(np.arccos(cosines.max(1))).max() < apart_deg, "each has a near neighbour"
    assert np.abs(directions.sum(0)).max() < 1e-9


def test_views_show_the_whole_model_where_their_pose_puts_it():
    mesh = box()
    templates = render_templates(ObjectModel(1, mesh, 112.0, np.eye(4)[None], {}), 42, 64)
    assert templates.masks.shape == (42, 64, 64) and templates.colors.dtype == np.uint8
    rim = templates.masks.copy()
    rim[:, 1:-1, 1:-1] = False
    assert not rim.any(), "none is cut off"
    assert templates.masks.any(1).sum(1).max() > 45, "the largest view fills the picture"
    assert (templates.colors[~templates.masks] == 0).all()
    shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
    rendered = DepthRenderer(mesh).render(templates.camera_from_model[7], shift @ templates.intrinsics, 64, 64).image(64, 64)
    np.testing.assert_allclose(rendered, templates.depths_mm[7], atol=0.01)


def test_the_command_writes_what_reads_back(tmp_path):
    write_ply(tmp_path / "models" / "obj_000004.ply", box())
    (tmp_path / "models" / "models_info.json").write_text('{"4": {"diameter": 112.25}}')
    words = ["--method", "templates", "--models", tmp_path / "models", "--side-px", 32, "--out", tmp_path / "templates"]
    assert stage_main("zeroshop_steps.detect", ["--method", "templates", *map(str, words)]) == 0
    templates = read_templates(tmp_path / "templates", 4)
    assert isinstance(templates, Templates) and templates.depths_mm.shape == (42, 32, 32)
    with pytest.raises(StepError, match="no views of object 5"):
        read_templates(tmp_path / "templates", 5)
