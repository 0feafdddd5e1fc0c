"""Models damaged on purpose: larger or smaller about their centre with symmetries that still hold, or without the underside."""

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from helpers.small_dataset import BOX, CAN, write_models
from zeroshop_steps.bop.damage_models import open_underside, scale_mesh, scale_symmetries
from zeroshop_steps.bop.formats.models import read_models
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.cli import stage_main


def off_centre_box():
    """A box that does not lie about its origin, with the half turn that maps it onto itself."""
    shape = trimesh.creation.box((40, 20, 60)).subdivide()
    shape.apply_translation((7, -3, 30))
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    half_turn[:3, 3] = 14, -6, 0
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces)), half_turn


def test_a_scaled_model_keeps_its_centre_and_its_symmetry():
    mesh, half_turn = off_centre_box()
    scaled = scale_mesh(mesh, 1.1)
    np.testing.assert_allclose(np.ptp(scaled.vertices, axis=0), (44, 22, 66))
    np.testing.assert_allclose(scaled.vertices.min(0) + scaled.vertices.max(0), mesh.vertices.min(0) + mesh.vertices.max(0))
    info = {"symmetries_discrete": [half_turn.ravel().tolist()], "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [7, -3, 0]}]}
    found = scale_symmetries(info, mesh, 1.1)
    moved = np.reshape(found["symmetries_discrete"][0], (4, 4))
    turned = scaled.vertices @ moved[:3, :3].T + moved[:3, 3]
    assert cKDTree(scaled.vertices).query(turned)[0].max() < 1e-9
    np.testing.assert_allclose(found["symmetries_continuous"][0]["offset"][:2], (7, -3))


def test_without_its_underside_a_box_lacks_just_that():
    mesh, _ = off_centre_box()
    opened = trimesh.Trimesh(*(getattr(open_underside(mesh), name) for name in ("vertices", "faces")), process=False)
    np.testing.assert_allclose(opened.area, 2 * (40 + 20) * 60 + 40 * 20)
    assert opened.vertices[:, 2].min() == 0 and len(np.unique(opened.faces)) == len(opened.vertices)


def test_the_command_writes_models_that_estimators_read(dataset):
    out = dataset.folder / "damaged"
    words = ["--method", "damage_models", "--models", str(dataset.folder / "models"), "--out", str(out)]
    assert stage_main("zeroshop_steps.bop", [*words, "--scale-percent", "-10", "--open-underside"]) == 0
    true, damaged = (read_models(folder, [BOX, CAN]) for folder in (dataset.folder / "models", out))
    for number in (BOX, CAN):
        assert 0.85 < damaged[number].diameter_mm / true[number].diameter_mm < 0.91
        assert len(damaged[number].mesh.faces) < len(true[number].mesh.faces)
    assert len(damaged[CAN].symmetries) == len(true[CAN].symmetries)
    assert stage_main("zeroshop_steps.bop", [*words, "--scale-percent", "-95"]) == 1


def test_single_models_get_errors_of_their_own(tmp_path, capsys):
    write_models(tmp_path / "models")
    words = ["--method", "damage_models", "--models", str(tmp_path / "models"), "--scale-percent", "5"]
    assert stage_main("zeroshop_steps.bop", [*words, "--scale-percent-of", f"{CAN}=-7.22", "--out", str(tmp_path / "out")]) == 0
    folders = (read_models(tmp_path / folder, [BOX, CAN]) for folder in ("models", "out"))
    sizes = [np.ptp(model.mesh.vertices, axis=0) for models in folders for model in models.values()]
    np.testing.assert_allclose(sizes[2] / sizes[0], 1.05, rtol=1e-5)
    np.testing.assert_allclose(sizes[3] / sizes[1], 0.9278, rtol=1e-5)
    for wrong, said in ((f"{CAN}", "is no OBJECT=PERCENT"), (f"{CAN}=-95", "is no error of a scale")):
        assert stage_main("zeroshop_steps.bop", [*words, "--scale-percent-of", wrong, "--out", str(tmp_path / "other")]) == 1
        assert said in capsys.readouterr().err
