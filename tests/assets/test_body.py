"""The body of a mesh: its mass, its files, and what is refused."""

import numpy as np
import pytest
import trimesh

from helpers.faults import step
from helpers.small_bodies import make_box, write_product
from zeroshop_steps.assets.body import find_mass
from zeroshop_steps.assets.body_files import read_body
from zeroshop_steps.assets.convex_parts import split_convex
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError


def test_a_measured_mass_is_taken_as_it_is_and_a_density_says_how_sure_it_is(capsys):
    assert find_mass(0.001, 0.6, 850.0, 2.2, "a.ply").mass_kg == 0.6
    assert not capsys.readouterr().err
    guessed = find_mass(0.001, None, 850.0, 2.2, "a.ply")
    assert np.isclose(guessed.mass_kg, 0.85) and (guessed.source, guessed.factor) == ("density", 2.2)
    assert "was not measured: 0.85 kg" in capsys.readouterr().err


def test_a_mass_in_grams_is_noticed():
    with pytest.raises(StepError, match=r"a\.ply would weigh 600 kg.*masses are in kilograms"):
        find_mass(0.001, 600.0, None, 2.2, "a.ply")
    with pytest.raises(StepError, match=r"1 cm\^3, so 0\.6 kg would be 6e\+05 kg/m\^3.*meshes in millimetres"):
        find_mass(1e-6, 0.6, None, 2.2, "a.ply")


def test_a_hollow_is_left_open_by_the_parts():
    outer, inner = trimesh.creation.box((0.1, 0.1, 0.08)), trimesh.creation.box((0.08, 0.08, 0.08))
    tray = trimesh.boolean.difference([outer, inner.apply_translation((0, 0, 0.01))], engine="manifold")
    parts = split_convex(Mesh(np.asarray(tray.vertices, float), np.asarray(tray.faces, np.int64)), 0.05, 24, seed=0)
    assert 4 <= len(parts) <= 24
    inside = np.array([[0.0, 0.0, 0.02], [0.02, 0.02, 0.03]])
    for part in parts:
        hull = trimesh.Trimesh(part.vertices, part.faces)
        assert not hull.contains(inside).any() and hull.is_convex and hull.volume > 0 and len(part.vertices) <= 64


def test_a_part_without_volume_is_left_out():
    box = trimesh.creation.box((0.06, 0.04, 0.02))
    flat = trimesh.creation.box((0.06, 0.04, 1e-12))

    class Library:
        Mesh = staticmethod(lambda vertices, faces: None)
        run_coacd = staticmethod(lambda mesh, **options: [(np.asarray(shape.vertices), None) for shape in (flat, box)])

    parts = split_convex(Mesh(np.asarray(box.vertices), np.asarray(box.faces, np.int64)), 0.05, 24, seed=0, load=lambda: Library)
    assert len(parts) == 1 and np.isclose(np.ptp(parts[0].vertices, axis=0)[2], 0.02)


def test_the_same_mesh_gives_the_same_bytes(tmp_path):
    mesh = write_product(tmp_path / "2dgs.ply", make_box())
    for name in ("one", "two"):
        assert step("assets", "body", mesh=mesh, name="box", mass_kg=0.2, out=tmp_path / f"{name}.body") == 0
    files = sorted(path.name for path in (tmp_path / "one.body").iterdir())
    assert files == ["body.json", "part_00.obj", "texture.png", "visual.mtl", "visual.obj"]
    assert all((tmp_path / "one.body" / name).read_bytes() == (tmp_path / "two.body" / name).read_bytes() for name in files)


def test_a_body_that_lacks_a_part_and_one_elsewhere_are_refused(tmp_path):
    mesh = write_product(tmp_path / "2dgs.ply", make_box())
    assert step("assets", "body", mesh=mesh, mass_kg=0.2, out=tmp_path / "2dgs.body") == 0
    assert step("assets", "urdf", body=tmp_path / "2dgs.body", out=tmp_path / "elsewhere/2dgs.urdf") == 1
    (tmp_path / "2dgs.body/part_00.obj").unlink()
    with pytest.raises(StepError, match=r"2dgs\.body lacks part_00\.obj"):
        read_body(tmp_path / "2dgs.body")


@pytest.mark.parametrize(
    ("suffix", "colors"), [(".stl", ""), (".ply", "vertex_colors"), (".glb", "vertex_colors"), (".ply", "face_colors")]
)
def test_models_of_others_become_bodies_without_a_record(tmp_path, suffix, colors):
    """Where the unit is said to be the millimetre: grey, or with the model's colours as a texture."""
    from pxr import Usd

    shape = make_box()
    if colors:
        count = len(shape.vertices if colors == "vertex_colors" else shape.faces)
        setattr(shape.visual, colors, np.tile(np.uint8([200, 30, 40, 255]), (count, 1)))
    shape.export(tmp_path / f"cad{suffix}")
    body = tmp_path / "cad.body"
    assert step("assets", "body", mesh=tmp_path / f"cad{suffix}", unknown_scale="millimetres", mass_kg=0.1, out=body) == 0
    assert read_body(body).facts["scale"] == "assumed"
    assert (body / "texture.png").is_file() == ("map_Kd" in (body / "visual.mtl").read_text()) == bool(colors)
    if colors:
        assert np.abs(read_image(body / "texture.png").astype(int) - [200, 30, 40]).max() <= 1
    assert step("assets", "usd", body=body, out=tmp_path / "cad.usda") == 0
    stage = Usd.Stage.Open(str(tmp_path / "cad.usda"))
    assert bool(stage.GetPrimAtPath(f"{stage.GetDefaultPrim().GetPath()}/Looks/surface/texture")) == bool(colors)
