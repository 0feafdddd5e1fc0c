"""A mesh reaches a robot in metres, or not at all."""

import numpy as np
import pytest
import trimesh

from zeroshop_steps.geometry.meshes.metric_mesh import MILLIMETRES, read_metric_mesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json


def write_box(folder, **facts):
    box = trimesh.creation.box((60, 40, 20))
    write_ply(folder / "2dgs.ply", Mesh(np.asarray(box.vertices), np.asarray(box.faces)))
    if facts:
        write_json(folder / "2dgs.json", {"scale_source": "known_height", "height_m": 0.02, "height_deviation_m": 0.001} | facts)
    return folder / "2dgs.ply"


def test_a_known_scale_becomes_metres(tmp_path):
    metric = read_metric_mesh(write_box(tmp_path, scale="known"))
    assert np.allclose(np.ptp(metric.mesh.vertices, axis=0), (0.06, 0.04, 0.02))
    assert metric.scale == "known" and np.isclose(metric.relative_deviation, 0.05)


def test_an_unknown_scale_is_refused_unless_the_user_says_what_it_is(tmp_path, capsys):
    path = write_box(tmp_path, scale="unknown", height_m=None, height_deviation_m=None)
    with pytest.raises(StepError, match=r"scale of .*2dgs\.ply is unknown.*60 x 40 x 20.*height_m.*unknown_scale: millimetres"):
        read_metric_mesh(path)
    assert read_metric_mesh(path, MILLIMETRES).scale == "assumed" and "warning" in capsys.readouterr().err


def test_a_mesh_without_a_record_is_refused_and_a_true_model_is_not(tmp_path):
    path = write_box(tmp_path)
    with pytest.raises(StepError, match=r"scale of .*2dgs\.ply is unknown \(2dgs\.json does not exist\)"):
        read_metric_mesh(path)
    write_json(tmp_path / "model_info.json", {"diameter": 74.8})
    assert read_metric_mesh(path).scale_source == "model"
