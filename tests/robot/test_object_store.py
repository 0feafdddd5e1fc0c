"""A robot's models: named, refused where their scale is unknown, and read again when they were made anew."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from helpers.painted_scene import CAN, CARTON, can, carton
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.robot import object_store
from zeroshop_steps.robot.object_store import ObjectStore
from zeroshop_steps.runtime.errors import StepError


def write_result(folder: Path, name: str, mesh: Mesh, scale: str = "known") -> None:
    """A mesh as the workflow leaves it."""
    path = folder / name / "2dgs.ply"
    write_ply(path, mesh.with_normals(), "2dgs.png")
    write_image(path.with_suffix(".png"), mesh.texture)
    path.with_suffix(".json").write_text(json.dumps({"scale": scale, "scale_source": "marker" if scale == "known" else None}))


@pytest.fixture
def results(tmp_path) -> Path:
    write_result(tmp_path, "carton", carton())
    write_result(tmp_path, "can", can())
    return tmp_path


def test_models_of_bop_have_their_numbers_and_names(dataset, tmp_path):
    shutil.copytree(dataset.folder / "models", tmp_path / "models")
    listed = json.loads((tmp_path / "models/models_info.json").read_text())
    listed[str(CAN)]["name"] = "green_can"
    (tmp_path / "models/models_info.json").write_text(json.dumps(listed))
    store = ObjectStore(tmp_path / "models")
    assert list(store.models) == [CARTON, CAN]
    assert store.find("green_can").model.object_id == CAN and store.name_of(CARTON) == f"obj_{CARTON:06d}"


def test_meshes_of_the_workflow_are_named_by_their_folders(results):
    store = ObjectStore(results)
    assert sorted(store.objects) == ["can", "carton"] and sorted(store.models) == [1, 2]
    assert store.find("can").model.diameter_mm == pytest.approx(np.hypot(70, 100), rel=0.01)
    assert store.find("can").description == "mesh of ZeroShOP in millimetres, scale from marker"


def test_only_the_wanted_models_are_read(results):
    assert list(ObjectStore(results, objects=["can"]).objects) == ["can"]
    with pytest.raises(StepError, match="has no usable model of cup. Known objects: can"):
        ObjectStore(results, objects=["can", "cup"])


def test_an_unknown_name_lists_the_known_ones(results):
    with pytest.raises(StepError, match="there is no object 'cup' here. Known objects: can, carton"):
        ObjectStore(results).find("cup")


def test_a_model_of_unknown_scale_is_refused(results):
    write_result(results, "can", can(), scale="unknown")
    store = ObjectStore(results)
    assert list(store.objects) == ["carton"]
    with pytest.raises(StepError, match="the scale of .*can/2dgs.ply is unknown.*give its height"):
        store.find("can")
    write_result(results, "can", can())
    store.refresh()
    assert store.find("can").model.object_id != store.find("carton").model.object_id, "taken once its scale is known"
    write_result(results, "can", can(), scale="unknown")
    store.refresh()
    with pytest.raises(StepError, match="is unknown"):
        store.find("can")


def test_a_mesh_made_anew_is_taken_at_the_next_look(results):
    store = ObjectStore(results)
    before, generation = store.find("can"), store.generation
    store.refresh()
    assert store.generation == generation and store.find("can") is before, "nothing was written"
    mesh = can()
    write_result(results, "can", Mesh(mesh.vertices * 1.1, mesh.faces, None, mesh.uv, mesh.texture))
    store.refresh()
    assert store.generation == generation + 1 and store.find("carton").version
    assert store.find("can").model.diameter_mm == pytest.approx(before.model.diameter_mm * 1.1)
    assert store.find("can").model.object_id == before.model.object_id


def test_a_mesh_that_is_gone_or_damaged_leaves_the_former_one(results, capsys):
    store = ObjectStore(results)
    before = store.find("can")
    (results / "can/2dgs.ply").unlink()
    store.refresh()
    assert store.find("can") is before, "Snakemake removes a mesh before it makes the next one"
    (results / "can/2dgs.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    store.refresh()
    assert store.find("can") is before and "warning: can: " in capsys.readouterr().err


def test_views_are_rendered_once_for_each_version(results, tmp_path, monkeypatch):
    rendered = []
    save = object_store.save_templates
    monkeypatch.setattr(object_store, "SIDE_PX", 32)
    monkeypatch.setattr(
        object_store, "save_templates", lambda folder, model, *size: rendered.append(model.object_id) or save(folder, model, *size)
    )
    folder = tmp_path / "views"
    store = ObjectStore(results, templates=folder)
    number = store.find("can").model.object_id
    assert np.array_equal(store.views_of(number).depths_mm, store.views_of(number).depths_mm) and rendered == [number]
    again = ObjectStore(results, templates=folder)
    assert np.array_equal(again.views_of(number).colors, store.views_of(number).colors) and rendered == [number], "kept between starts"
    mesh = can()
    write_result(results, "can", Mesh(mesh.vertices * 1.1, mesh.faces, None, mesh.uv, mesh.texture))
    again.refresh()
    again.views_of(number)
    assert rendered == [number, number]


def test_a_folder_without_models_says_what_was_expected(tmp_path):
    with pytest.raises(StepError, match=r"no usable model.*expected models_info.json or OBJECT/2dgs.ply"):
        ObjectStore(tmp_path)
