"""The package `zeroshop`: what scripts import."""

import pytest

import zeroshop
from zeroshop_steps.app import reconstruct_object
from zeroshop_steps.runtime.files import write_json


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "mug"
    folder.mkdir()
    (folder / "1.png").touch()
    return folder


def answer(monkeypatch, done, facts=None):
    """Let the workflow write the JSON of a mesh, or fail; returns the targets that it is asked for."""
    asked = []

    def run(target, folder, table, cores, log, settings=None):
        asked.append(target)
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text("error: the cameras are wrong\n")
        if done and target.endswith(".ply"):
            (folder / target).parent.mkdir(parents=True, exist_ok=True)
            (folder / target).touch()
            write_json((folder / target).with_suffix(".json"), facts)
        return done

    monkeypatch.setattr(reconstruct_object, "run_workflow", run)
    monkeypatch.setattr("zeroshop_steps.capture.photo_files.is_cut_out", lambda folder: False)
    return asked


def test_photos_become_an_asset_that_can_be_exported_and_found_again(photos, tmp_path, monkeypatch):
    facts = {"scale": "known", "extents": [80.0, 90.0, 96.0], "grade": {"grade": "good"}}
    asked = answer(monkeypatch, True, facts)
    asset = zeroshop.reconstruct(photos, height_m=0.096, into=tmp_path, cores=1)
    assert asset.mesh == tmp_path / "results/photos/mug/2dgs.ply" and asset.grade == "good" and asset.extents_mm == (80.0, 90.0, 96.0)
    assert asset.cameras == tmp_path / "results/photos/mug/video/auto/cameras"
    assert asset.export("urdf") == tmp_path / "results/photos/mug/2dgs.urdf"
    assert zeroshop.load("mug", into=tmp_path).facts == facts
    assert asked == ["results/photos/mug/2dgs.ply", "results/photos/mug/2dgs.urdf"]
    with pytest.raises(zeroshop.StepError, match="there is no export obj; there are urdf, mjcf"):
        asset.export("obj")
    with pytest.raises(zeroshop.StepError, match="Meshes made here: mug"):
        zeroshop.load("can", into=tmp_path)


def test_an_unknown_scale_is_no_number(photos, tmp_path, monkeypatch):
    answer(monkeypatch, True, {"scale": "unknown", "extents": [1.0, 1.0, 1.0], "grade": {"grade": "sparse"}})
    assert zeroshop.reconstruct(photos, into=tmp_path).extents_mm is None


def test_a_failure_raises_with_its_reason(photos, tmp_path, monkeypatch):
    answer(monkeypatch, False)
    with pytest.raises(zeroshop.StepError, match="the cameras are wrong"):
        zeroshop.reconstruct(photos, into=tmp_path)
    with pytest.raises(zeroshop.StepError, match="it is in metres"):
        zeroshop.reconstruct(photos, height_m=96, into=tmp_path)
    with pytest.raises(zeroshop.StepError, match="0 captures are given"):
        zeroshop.reconstruct(into=tmp_path)
