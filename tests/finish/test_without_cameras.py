"""A mesh that was generated without cameras is finished: its colours become a texture, and all of it is marked as a guess."""

import numpy as np
import pytest
import trimesh

from helpers.faults import step
from zeroshop_steps.finish.preview import draw_around
from zeroshop_steps.finish.texture import bake_colors
from zeroshop_steps.finish.texturing.atlas import rasterize_atlas
from zeroshop_steps.finish.texturing.unwrap import unwrap_mesh
from zeroshop_steps.geometry.imaging.contact_sheets import TILE_WIDTH_PX
from zeroshop_steps.geometry.meshes.mass_properties import count_open_edges
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.files import read_json, write_json

RADIUS = 20.0


def gradient(points: np.ndarray) -> np.ndarray:
    """Colours from 0 to 255 that change linearly along x, y and z."""
    return 127.5 + 120.0 * points / RADIUS


def colored_ball(subdivisions: int) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions, RADIUS)
    points = np.array(ball.vertices)
    return Mesh(points, np.array(ball.faces, np.int64), colors=np.rint(gradient(points)).astype(np.uint8))


def write_raw(folder, mesh, **facts):
    """A raw mesh as trellis makes it without cameras."""
    folder.mkdir(exist_ok=True)
    write_ply(folder / "raw_mesh.ply", mesh)
    write_json(folder / "raw_mesh.json", {"generated": True, "height_m": 0.05, "seconds": 1.0} | facts)
    return folder / "raw_mesh.ply"


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """The folder of a finished cell: a ball that is said to be 50 mm high, whose dust and hole are to go."""
    folder = tmp_path_factory.mktemp("cell")
    ball = colored_ball(3)
    dust = Mesh(0.02 * ball.vertices + 30.0, ball.faces)
    raw = Mesh(
        np.r_[ball.vertices, dust.vertices], np.r_[ball.faces[200:], dust.faces + len(ball.vertices)], colors=np.tile(ball.colors, (2, 1))
    )
    mesh = write_raw(folder, raw)
    assert count_open_edges(raw) > 30
    assert step("finish", "without_cameras", mesh=mesh, texture_size=256, out=folder / "mesh.ply") == 0
    return folder


def test_a_gradient_of_the_vertices_is_in_the_texture_at_the_centre_of_every_texel():
    ball, size = colored_ball(4), 256
    unwrapped, _ = unwrap_mesh(Mesh(ball.vertices, ball.faces), size)
    texture, texels = bake_colors(unwrapped, ball, size), rasterize_atlas(unwrapped, size)
    points = np.einsum("nk,nkd->nd", texels.barycentric, unwrapped.vertices[unwrapped.faces[texels.face]])
    error = np.abs(texture[texels.row, texels.column] - gradient(points))
    assert len(points) > 0.3 * size**2
    assert error.max() < 1.01  # colours of vertices and of texels are rounded by up to 0.5 each


def test_a_coarse_mesh_keeps_the_colours_of_a_fine_one():
    """The print of the fine mesh is finer than the vertices of the coarse one."""
    fine, coarse = colored_ball(5), colored_ball(2)
    stripes = np.where(np.sin(fine.vertices[:, 2:]) > 0, 255, 0) * np.ones((1, 3))
    fine = Mesh(fine.vertices, fine.faces, colors=stripes.astype(np.uint8))
    unwrapped, _ = unwrap_mesh(Mesh(coarse.vertices, coarse.faces), 256)
    texture, texels = bake_colors(unwrapped, fine, 256), rasterize_atlas(unwrapped, 256)
    points = np.einsum("nk,nkd->nd", texels.barycentric, unwrapped.vertices[unwrapped.faces[texels.face]])
    points *= RADIUS / np.linalg.norm(points, axis=1, keepdims=True)  # of the ball, which the coarse mesh cuts
    wave = np.sin(points[:, 2])
    clear = np.abs(wave) > 0.7
    right = (texture[texels.row, texels.column, 0] > 127) == (wave > 0)
    assert clear.sum() > 10000 and right[clear].mean() > 0.99


def test_the_finished_mesh_is_whole_as_high_as_said_and_a_guess(cell):
    mesh, facts = read_ply(cell / "mesh.ply"), read_json(cell / "mesh.json")
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(50.0, abs=1e-3)
    np.testing.assert_allclose(mesh.vertices.min(0), -mesh.vertices.max(0), atol=1e-3)
    assert count_open_edges(mesh) == 0 and facts["underside"]["watertight"] and facts["dropped_parts"]["small"] == 1
    assert facts["generated"] and (facts["scale"], facts["height_m"], facts["scale_source"]) == ("known", 0.05, "known_height")
    assert (facts["underside"]["seen"], facts["underside"]["first_face"], facts["underside"]["faces"]) == (False, 0, len(mesh.faces))
    assert "nothing of it was measured" in facts["frame_facts"]["warnings"][0]
    assert mesh.texture_image.shape == (256, 256, 3) and (cell / "mesh.glb").stat().st_size > 1000
    picture = draw_around(mesh, 2)
    assert picture.shape == (2 * TILE_WIDTH_PX, 2 * TILE_WIDTH_PX, 3)
    middle = picture[TILE_WIDTH_PX // 2, TILE_WIDTH_PX // 2].astype(float)  # seen from +x, 25 degrees above
    toward = RADIUS * np.array([np.cos(np.radians(25)), 0, np.sin(np.radians(25))])
    assert np.abs(middle - gradient(toward)).max() < 12


def test_the_published_mesh_has_no_grade_and_no_measured_place(cell, tmp_path, capsys):
    assert step("evaluate", "finished_mesh", mesh=cell / "mesh.ply", out=tmp_path / "grade.json") == 0
    parts = {"evidence": tmp_path / "evidence.npz", "grade": tmp_path / "grade.json", "preview": tmp_path / "mesh_preview.png"}
    assert step("finish", "publish", mesh=cell / "mesh.ply", out=tmp_path / "trellis.ply", **parts) == 0
    mesh, facts = read_ply(tmp_path / "trellis.ply"), read_json(tmp_path / "trellis.json")
    assert not mesh.seen_faces().any() and not mesh.measured_faces().any()
    assert facts["area_shares"] == {"unseen": 1.0, "assumed": 0.0, "measured": 0.0}
    assert facts["grade"]["grade"] == "none" and "nothing was measured" in facts["grade"]["reasons"][0] and facts["generated"]
    assert "grade,none," in (tmp_path / "grade.csv").read_text()
    capsys.readouterr()
    assert step("assets", "body", "--mass-kg", 0.1, "--most-parts", 1, mesh=tmp_path / "trellis.ply", out=tmp_path / "body") == 0
    assert "was generated without cameras: its shape is a guess" in capsys.readouterr().err
    body = read_json(tmp_path / "body/body.json")
    assert body["generated"] and body["frame"].endswith("z up and x as generated; metres")
    words = {"mesh": cell / "mesh.ply", "evidence": tmp_path / "evidence.npz", "out": tmp_path / "grasps.json"}
    assert step("grasp", "antipodal", **words) != 0
    assert "was measured, and grasps are found on measured surface alone" in capsys.readouterr().err


def test_without_a_height_the_scale_is_unknown_and_robots_refuse_the_mesh(tmp_path, capsys):
    raw = write_raw(tmp_path, colored_ball(2), height_m=None)
    assert step("finish", "without_cameras", mesh=raw, texture_size=64, out=tmp_path / "mesh.ply") == 0
    facts = read_json(tmp_path / "mesh.json")
    assert (facts["scale"], facts["height_m"], facts["ply_unit"]) == ("unknown", None, "unknown")
    assert "height_m in config/objects.tsv" in capsys.readouterr().err
    assert step("assets", "body", "--mass-kg", 0.1, mesh=tmp_path / "mesh.ply", out=tmp_path / "body") != 0
    assert "the scale of" in capsys.readouterr().err and not (tmp_path / "body").exists()


def test_other_meshes_are_refused(tmp_path, capsys):
    """One that was measured, one without colours, and one with cameras that is to be graded without."""
    measured = write_raw(tmp_path / "measured", colored_ball(1), generated=False)
    bare = write_raw(tmp_path / "bare", Mesh(colored_ball(1).vertices, colored_ball(1).faces))
    for raw, reason in ((measured, "is not of a mesh that was generated without cameras"), (bare, "has no colours")):
        assert step("finish", "without_cameras", mesh=raw, out=tmp_path / "mesh.ply") != 0
        assert reason in capsys.readouterr().err
    write_ply(tmp_path / "graded.ply", colored_ball(1))
    write_json(tmp_path / "graded.json", {"frame_facts": {}})
    assert step("evaluate", "finished_mesh", mesh=tmp_path / "graded.ply", out=tmp_path / "grade.json") != 0
    assert "its grade needs them; give them as --cameras" in capsys.readouterr().err
    assert not list(tmp_path.glob("mesh.*")) and not list(tmp_path.glob("grade.*"))
