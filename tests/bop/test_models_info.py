"""models_info.json: computed where it is missing, with symmetries where asked; diagonals of boxes in place of diameters."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.bop.formats.symmetry import check_symmetries, list_symmetry_transforms
from zeroshop_steps.bop.shape_symmetry import find_symmetries
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError

UPRIGHT = trimesh.creation.box((20, 20, 40)).apply_translation([20, 0, 30])
TYOL = Path(__file__).parents[3] / "shared/data/reports/tyol"


def to_mesh(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int64))


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """A ball as PLY, and a box as OBJ; no models_info.json."""
    folder = tmp_path / "models"
    write_ply(folder / "obj_000003.ply", to_mesh(trimesh.creation.icosphere(3, 50.0)))
    trimesh.creation.box((60, 40, 20)).export(folder / "obj_000005.obj")
    return folder


def test_a_missing_file_is_computed(models: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert list_objects(models) == [3, 5]
    read = read_models(models, [3, 5])
    assert read[3].diameter_mm == pytest.approx(100, rel=1e-3) and read[5].diameter_mm == pytest.approx(np.sqrt(5600))
    said = capsys.readouterr().err
    assert said.count("models_info.json does not exist") == 1 and "--method models_info --symmetries" in said
    with pytest.raises(StepError, match=r"object 4 has no model .* it has the objects \[3, 5\]"):
        read_models(models, [4])


def test_numbers_with_zeros_before_them_are_numbers(models: Path) -> None:
    (models / "models_info.json").write_text(json.dumps({"000003": {"diameter": 100.0}, "5": {"diameter": 74.8}}))
    assert list(read_models(models, [3, 5])) == [3, 5]


def test_the_command_writes_it_with_symmetries(models: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["--method", "models_info", "--symmetries", "--models", str(models)]
    assert stage_main("zeroshop_steps.bop", command) == 0
    listed = json.loads((models / "models_info.json").read_text())
    assert len(listed["3"]["symmetries_continuous"]) == 3 and len(listed["5"]["symmetries_discrete"]) == 3
    assert listed["5"]["size_x"] == 60 and listed["5"]["min_z"] == -10 and len(read_models(models, [5])[5].symmetries) == 4
    assert stage_main("zeroshop_steps.bop", command) == 1 and "exists already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("shape", "discrete", "continuous"),
    [
        (trimesh.creation.cylinder(20, 60, sections=6), 11, 0),
        (trimesh.creation.cylinder(20, 60, sections=64), 1, 1),
        (trimesh.creation.cone(20, 60, sections=64), 0, 1),
        (
            trimesh.util.concatenate(
                [trimesh.creation.box((60, 20, 20)), trimesh.creation.box((20, 20, 40)).apply_translation([20, 0, 30])]
            ),
            0,
            0,
        ),
    ],
)
def test_symmetries_of_a_shape_are_found(shape: trimesh.Trimesh, discrete: int, continuous: int) -> None:
    mesh = to_mesh(shape.copy().apply_translation([3, -4, 5]))
    found = find_symmetries(mesh, 72.0)
    check_symmetries(found, "the shape")
    assert (len(found.get("symmetries_discrete", [])), len(found.get("symmetries_continuous", []))) == (discrete, continuous)
    for transform in list_symmetry_transforms(found, 0.5):
        moved = mesh.vertices @ transform[:3, :3].T + transform[:3, 3]
        assert np.abs(np.ptp(moved, axis=0) - np.ptp(mesh.vertices, axis=0)).max() < 3


@pytest.mark.parametrize(("listed", "says"), [({"diameter": 122.2}, "is the diagonal of its box"), ({}, ""), ({"diameter": 90.0}, None)])
def test_listed_diameters(tmp_path: Path, capsys: pytest.CaptureFixture[str], listed: dict, says: str | None) -> None:
    """A ball in a box of 70.5 x 70.5 x 70.5 mm measures 70.5, and the diagonal of the box 122.2 mm."""
    write_ply(tmp_path / "obj_000001.ply", to_mesh(trimesh.creation.icosphere(4, 35.27)))
    (tmp_path / "models_info.json").write_text(json.dumps({"1": listed}))
    if says is None:
        with pytest.raises(StepError, match="the two do not belong together"):
            read_models(tmp_path, [1])
        return
    model = read_models(tmp_path, [1])[1]
    assert says in capsys.readouterr().err
    assert model.diameter_mm == pytest.approx(70.5, rel=0.01)
    assert model.scored_diameter_mm == pytest.approx(listed.get("diameter", 70.5), rel=0.01)


def test_symmetries_may_be_rows_of_a_matrix(models: Path) -> None:
    matrix = np.diag([1.0, -1, -1, 1]).tolist()
    (models / "models_info.json").write_text(json.dumps({"5": {"diameter": 74.8, "symmetries_discrete": [matrix]}}))
    assert np.array_equal(read_models(models, [5])[5].symmetries[1], matrix)


def test_published_diameters_of_tyol() -> None:
    if not TYOL.is_dir():
        pytest.skip(f"{TYOL} is not here")
    model = read_models(TYOL / "models", [19])[19]
    assert model.diameter_mm == pytest.approx(253.3, abs=0.1) and model.scored_diameter_mm == pytest.approx(338.1, abs=0.1)
