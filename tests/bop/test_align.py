"""A mesh that was moved, turned, scaled and damaged finds back; print decides where shape does not; the folder suits BOP's reader."""

import json

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from zeroshop_steps.bop import align as align_method
from zeroshop_steps.bop.align import align, describe_scale
from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.bop.formats.symmetry import list_symmetry_transforms
from zeroshop_steps.geometry.alignment import similarity_icp, similarity_search
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.geometry.observation.support_classes import ASSUMED, MEASURED
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.synthetic.demo_objects import write_demo_object


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Folders of demo models: a printed can, whose shape turns about its axis, and a plain mug."""
    folder = tmp_path_factory.mktemp("models")
    for name in ("tomato_can", "mug"):
        write_demo_object(name, folder / name)
    return folder


@pytest.fixture
def few_samples(monkeypatch):
    """A sixth of the points, of which half are aligned, and half of the starts: what these tests show does not hang on their number."""
    monkeypatch.setattr(align_method, "SOURCE_SAMPLES", 1250)
    monkeypatch.setattr(align_method, "TARGET_SAMPLES", 6250)
    monkeypatch.setattr(similarity_icp, "SAMPLES", 625)
    monkeypatch.setattr(similarity_search, "DIRECTIONS", 30)


def damaged(mesh: Mesh, similarity: np.ndarray, seed: int = 0) -> Mesh:
    """The mesh without its underside, its vertices shaken by 0.3 mm, moved by a similarity."""
    rng = np.random.default_rng(seed)
    middles = mesh.vertices[mesh.faces].mean(1)
    kept = mesh.faces[middles[:, 2] > mesh.vertices[:, 2].min() + 2]
    shaken = mesh.vertices + rng.normal(0, 0.3, mesh.vertices.shape)
    used, faces = np.unique(kept, return_inverse=True)
    moved = shaken[used] @ similarity[:3, :3].T + similarity[:3, 3]
    return Mesh(moved, faces.reshape(-1, 3), None, mesh.uv[used], mesh.texture)


def similarity(rotation: Rotation, scale: float, move) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = scale * rotation.as_matrix(), move
    return transform


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1])
def test_a_printed_can_finds_back_from_any_turn_and_size(models, seed):
    truth = read_ply(models / "tomato_can" / "model.ply")
    rng = np.random.default_rng(seed)
    mesh_from_truth = similarity(Rotation.from_quat(rng.normal(size=4)), float(rng.uniform(0.2, 3.0)), rng.normal(0, 200, 3))
    fit = align(damaged(truth, mesh_from_truth), truth, np.eye(4)[None])
    rest = fit.transform @ mesh_from_truth
    moved = truth.vertices @ rest[:3, :3].T + rest[:3, 3]
    assert np.linalg.norm(moved - truth.vertices, axis=1).mean() < 0.5, "its print tells how it is turned about its axis"
    assert fit.likeness > 0.8


@pytest.mark.slow
def test_a_symmetric_object_is_turned_no_more_than_needed(models, few_samples):
    truth = read_ply(models / "mug" / "model.ply")
    info = {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}
    start = similarity(Rotation.from_rotvec([0, 0, 0.02]), 1.0, [0, 0, 0])
    fit = align(damaged(truth, start), truth, list_symmetry_transforms(info))
    assert np.degrees(Rotation.from_matrix(fit.transform[:3, :3]).magnitude()) < 3


@pytest.mark.slow
def test_a_lid_over_a_hollow_that_nobody_saw_does_not_spoil_the_size(few_samples):
    outside = np.array([[0.0, 0], [50, 0], [75, 25], [80, 55]])
    inside = np.array([[76.0, 55], [71, 26], [48, 4], [0, 4]])
    bowl, lidded = (trimesh.creation.revolve(profile, sections=64) for profile in (np.vstack([outside, inside]), [*outside, [0, 55]]))
    truth, mesh = (Mesh(np.asarray(shape.vertices), np.asarray(shape.faces)) for shape in (bowl, lidded))
    turns = list_symmetry_transforms({"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]})
    fit = align(mesh, truth, turns)
    assert np.cbrt(np.linalg.det(fit.transform[:3, :3])) == pytest.approx(1.0, abs=0.01)
    np.testing.assert_allclose(fit.transform[:3, 3], 0.0, atol=1.0)


def test_a_mesh_in_metres_is_said():
    assert "metres" in describe_scale(1003.0) and "unit" in describe_scale(25.4) and describe_scale(1.03) is None


def run(method, words) -> int:
    return stage_main("zeroshop_steps.bop", ["--method", method, *map(str, words)])


@pytest.mark.slow
def test_commands_make_a_folder_of_models(models, tmp_path, capsys):
    cell = tmp_path / "tomato_can"
    truth = read_ply(models / "tomato_can" / "model.ply")
    turn = similarity(Rotation.from_rotvec([0.1, 0, 0.5]), 0.001, [0, 0, 0.04])
    write_image(cell / "mesh.png", truth.texture)
    write_ply(cell / "mesh.ply", damaged(truth, turn), "mesh.png")
    evidence = np.full(len(read_ply(cell / "mesh.ply").vertices), MEASURED, np.uint8)
    evidence[:70] = ASSUMED
    np.savez(cell / "evidence.npz", evidence=evidence)
    assert run("align", ["--mesh", cell / "mesh.ply", "--model", models / "tomato_can/model.ply", "--out", cell / "aligned.json"]) == 0
    aligned = json.loads((cell / "aligned.json").read_text())
    assert "in metres, where millimetres are expected" in capsys.readouterr().err
    assert aligned["scale"] == pytest.approx(1000, rel=0.01) and aligned["mesh_to_truth_mm"] < 0.4
    write_failure([tmp_path / "lost.json"], Failure("finish.clean", "nothing is left"))
    assert run("export_models", ["--parts", cell / "aligned.json", tmp_path / "lost.json", "--out", tmp_path / "models_2dgs"]) == 0
    assert "lost.json is left out" in capsys.readouterr().err
    assert run("export_models", ["--parts", models / "tomato_can", models / "mug", "--out", tmp_path / "models"]) == 0
    number = aligned["model_info"]["obj_id"]
    assert list_objects(tmp_path / "models_2dgs") == [number] and len(list_objects(tmp_path / "models")) == 2
    ours, true = (read_models(tmp_path / name, [number])[number] for name in ("models_2dgs", "models"))
    assert ours.mesh.texture is not None and ours.mesh.normals is not None
    np.testing.assert_array_equal(ours.mesh.quality[60:80], np.repeat([0.5, 1.0], 10))
    assert true.mesh.quality is None
    assert ours.diameter_mm == pytest.approx(true.diameter_mm, rel=0.02)
    np.testing.assert_allclose(ours.mesh.vertices.max(0), true.mesh.vertices.max(0), atol=2.0)


@pytest.mark.slow
def test_what_was_not_measured_does_not_count(models, few_samples, tmp_path):
    """A plate across the can's top, which would spoil the alignment: a lid, or an underside that was closed without a photo."""
    truth = read_ply(models / "tomato_can" / "model.ply")
    plate = trimesh.creation.cylinder(45.0, 1.0)
    plate.apply_translation([0, 0, float(truth.vertices[:, 2].max()) + 40])
    vertices = np.concatenate([truth.vertices, plate.vertices])
    faces = np.concatenate([truth.faces, np.array(plate.faces) + len(truth.vertices)])
    write_ply(tmp_path / "mesh.ply", Mesh(vertices, faces))
    found = []
    for kind in (ASSUMED, MEASURED):
        np.savez(tmp_path / "evidence.npz", evidence=np.repeat([MEASURED, kind], [len(truth.vertices), len(plate.vertices)]))
        words = ["--mesh", tmp_path / "mesh.ply", "--evidence", tmp_path / "evidence.npz", "--model", models / "tomato_can/model.ply"]
        assert run("align", [*words, "--out", tmp_path / "aligned.json"]) == 0
        aligned = json.loads((tmp_path / "aligned.json").read_text())
        found.append((aligned["scale"], aligned["mesh_to_truth_95_percent_mm"]))
    assert found[0][0] == pytest.approx(1.0, abs=0.003) and found[0][1] < 0.5
    assert found[1][1] > 5.0, "the plate would count"


@pytest.mark.slow
def test_what_cannot_be_aligned_is_refused(models, few_samples, tmp_path, capsys):
    plate = trimesh.creation.box((160, 60, 3))
    write_ply(tmp_path / "mesh.ply", Mesh(plate.vertices, plate.faces))
    words = ["--mesh", tmp_path / "mesh.ply", "--model", models / "mug/model.ply", "--out", tmp_path / "aligned.json"]
    assert run("align", words) == 1 and "cannot be aligned" in capsys.readouterr().err
    assert run("export_models", ["--parts", models / "mug", models / "mug", "--out", tmp_path / "out"]) == 1
    assert "give every object once" in capsys.readouterr().err and not (tmp_path / "out").exists()
