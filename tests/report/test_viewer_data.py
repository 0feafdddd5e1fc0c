"""What the viewer gets: smaller meshes, distances as bytes, and the bundled scripts."""

import base64
import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pymeshlab
import pytest
import trimesh

from helpers.paths import REPOSITORY
from helpers.small_report import finished_cell, made_page
from helpers.solids import as_trimesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.report.site.mesh_reduction import TEXTURED_FACES, reduce_mesh
from zeroshop_steps.report.site.viewer_data import UNSEEN, quantize_distances
from zeroshop_steps.runtime.files import read_json, write_json

VIEWER = REPOSITORY / "src/zeroshop_steps/report/viewer"


def data_in(path: Path) -> dict:
    """What a data script hands to the page."""
    return json.loads(path.read_text().removeprefix("zeroshop.data(").removesuffix(");\n"))


def distances_in(path: Path) -> np.ndarray:
    """The levels of distance of a mesh's vertices."""
    return np.frombuffer(base64.b64decode(data_in(path)["distances"]), np.uint8)


@pytest.mark.slow
def test_distances_of_a_perfect_mesh_are_none_and_of_a_shifted_one_the_shift(tmp_path, carton):
    cell = finished_cell(tmp_path / "demo/carton", carton)
    page = made_page(tmp_path / "demo/carton", tmp_path / "report")
    assert distances_in(page / "mesh-su_h-colmap-2dgs.js").max() == 0
    notes = read_json(cell / "mesh.json")
    shifted = np.eye(4)
    shifted[2, 3] = 1.0
    notes["frame_facts"]["object_from_registration"] = shifted.tolist()
    write_json(cell / "mesh.json", notes)
    shutil.rmtree(page)
    page = made_page(tmp_path / "demo/carton", tmp_path / "report")
    found = data_in(page / "mesh-su_h-colmap-2dgs.js")
    millimetres = distances_in(page / "mesh-su_h-colmap-2dgs.js") / 254 * found["limit_mm"]
    assert millimetres.max() == pytest.approx(1.0, abs=0.01) and np.median(millimetres) < 0.01


def test_levels_of_distance():
    assert quantize_distances(np.array([0.0, 1.0, 2.0, 9.0, np.nan]), 2.0).tolist() == [0, 127, 254, 254, UNSEEN]


def test_a_reduced_mesh_keeps_its_shape_and_its_texture(carton):
    small = reduce_mesh(carton.mesh, 300, 64)
    assert len(small.mesh.faces) <= 300 and small.faces == len(carton.mesh.faces)
    assert small.mesh.texture.shape == (64, 64, 3)
    assert np.abs(small.mesh.vertices).max(0) == pytest.approx(np.abs(carton.mesh.vertices).max(0), abs=0.1)
    assert as_trimesh(small.mesh).area == pytest.approx(as_trimesh(carton.mesh).area, rel=0.01)


def test_a_reduced_mesh_keeps_its_shape_whatever_the_filter_did_before(carton):
    work = pymeshlab.MeshSet(verbose=False)
    work.add_mesh(pymeshlab.Mesh(carton.mesh.vertices, carton.mesh.faces.astype(np.int32)))
    options = {"preserveboundary": True, "boundaryweight": 2.0, "preservenormal": True, "planarquadric": True, "autoclean": True}
    work.meshing_decimation_quadric_edge_collapse(targetfacenum=1000, **options)
    assert as_trimesh(reduce_mesh(carton.mesh, 300, 64).mesh).area == pytest.approx(as_trimesh(carton.mesh).area, rel=1e-3)


@pytest.mark.slow
def test_a_mesh_beyond_reason_is_reduced_quickly():
    sphere = trimesh.creation.uv_sphere(50.0, count=[460, 460])
    mesh = Mesh(np.array(sphere.vertices), np.array(sphere.faces, np.int64))
    assert len(mesh.faces) > TEXTURED_FACES
    small = reduce_mesh(mesh, 5000, 64)
    assert 1000 < len(small.mesh.faces) <= 5000
    assert np.linalg.norm(small.mesh.vertices, axis=1) == pytest.approx(50.0, abs=0.5)


def test_the_bundled_scripts_are_those_of_their_sources():
    names = ["build.mjs", "package-lock.json", "package.json", *(f"src/{path.name}" for path in sorted(VIEWER.glob("src/*")))]
    digest = hashlib.sha256()
    for name in names:
        digest.update(f"{name}\n".encode() + (VIEWER / name).read_bytes())
    for script in ("page.js", "viewer.js"):
        head = (VIEWER.parent / "assets" / script).read_text().partition("\n")[0]
        assert head == f"/* sources {digest.hexdigest()} */", "the scripts have changed: run `make viewer`"
    assert "MIT" in (VIEWER.parent / "assets/three.LICENSE.txt").read_text()
