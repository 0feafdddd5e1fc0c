"""Clothespins and sheets: convex parts that are too thin to have a volume do not stop a simulator."""

import xml.etree.ElementTree as xml
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from zeroshop_steps.assets.body_files import Body, write_part_obj, write_textured_obj
from zeroshop_steps.assets.convex_parts import split_convex
from zeroshop_steps.assets.mjcf import describe_model
from zeroshop_steps.geometry.meshes.mass_properties import measure_solid
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError

JAWS = [
    trimesh.creation.box((0.07, 0.01, 0.004)),
    trimesh.creation.box((0.002, 0.0002, 0.0002)).apply_translation([0.05, 0, 0]),
    trimesh.creation.box((1e-4, 1e-5, 1e-7)).apply_translation([0.07, 0, 0]),
]


def to_mesh(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int64))


def test_mujoco_takes_parts_without_a_volume(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    folder = tmp_path / "pin.body"
    folder.mkdir()
    whole = to_mesh(trimesh.util.concatenate(JAWS))
    write_textured_obj(folder, whole)
    names = tuple(f"part_{number:02d}.obj" for number in range(len(JAWS)))
    for name, part in zip(names, JAWS, strict=True):
        write_part_obj(folder / name, to_mesh(part))
    solid = measure_solid(whole, "pin")
    body = Body(folder, "pin", 0.005, solid.centre, solid.inertia_of(0.005), 0.5, names, {})
    (tmp_path / "pin.xml").write_text(xml.tostring(describe_model(body, folder.name), encoding="unicode"))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "pin.xml"))
    assert model.ngeom == 4 and np.isclose(model.body_mass[1], 0.005)
    assert np.allclose(np.sort(model.body_inertia[1]), np.linalg.eigvalsh(body.inertia_kg_m2), rtol=1e-6)


@pytest.mark.parametrize(("shapes", "left"), [(JAWS, 2), (JAWS[2:], 1)])
def test_parts_that_no_simulator_feels_are_left_out(shapes: list[trimesh.Trimesh], left: int) -> None:
    mesh = to_mesh(trimesh.util.concatenate(shapes))
    found = [(np.asarray(shape.vertices), np.asarray(shape.faces)) for shape in shapes]
    library = SimpleNamespace(Mesh=lambda vertices, faces: None, run_coacd=lambda mesh, **options: found)
    assert len(split_convex(mesh, 0.08, 24, 0, lambda: library)) == left


def test_a_mesh_without_thickness_is_refused_as_such(recwarn: pytest.WarningsRecorder) -> None:
    sheet = to_mesh(trimesh.creation.box((0.2, 0.15, 0.001)).apply_scale([1, 1, 0]))
    with pytest.raises(StepError, match="sheet has no thickness"):
        measure_solid(sheet, "sheet")
    assert not recwarn.list
    foil = to_mesh(trimesh.creation.box((0.2, 0.15, 1e-6)))
    assert np.isclose(measure_solid(foil, "foil").volume, 3e-8)
