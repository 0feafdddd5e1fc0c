"""An object that touches its support in the middle alone does not get walls below its ends."""

import numpy as np
import pytest
import trimesh

from helpers.carton_scene import camera_at
from helpers.masked_view import MaskedView
from zeroshop_steps.finish import close, watertight
from zeroshop_steps.finish.overhang import fills_open_space
from zeroshop_steps.finish.underside import close_underside
from zeroshop_steps.geometry.mesh_rendering import MeshRenderer
from zeroshop_steps.geometry.meshes import Mesh, read_ply, write_ply
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json, write_json

UP, DOWN = np.array([0.0, 0.0, 1.0]), -0.9
BAR_MM, RISE_MM = (120.0, 30.0, 24.0), 5.0


def solid(overhangs: bool) -> trimesh.Trimesh:
    """A bar that lies on the plane z = 0, or one whose ends rise from it as a banana's do."""
    bar = trimesh.creation.box(BAR_MM).subdivide_to_size(4.0)
    bar.apply_translation([0, 0, BAR_MM[2] / 2])
    if overhangs:
        bar.vertices[:, 2] += RISE_MM * (2 * bar.vertices[:, 0] / BAR_MM[0]) ** 2
    return bar


def photographed(whole: trimesh.Trimesh) -> tuple[Mesh, list[MaskedView]]:
    """Its surface without what faces down, and views of it from all around."""
    mesh = Mesh(np.array(whole.vertices), np.array(whole.faces)).with_normals()
    renderer = MeshRenderer(mesh)
    rings = [camera_at(f"{k}_{elevation}.png", 36.0 * k, elevation, 260.0) for k in range(10) for elevation in (8.0, 45.0)]
    views = [MaskedView(camera, camera.name, None, renderer.cast_rays(camera).mask) for camera in rings]
    return Mesh(mesh.vertices, mesh.faces[whole.face_normals[:, 2] > DOWN]).without_loose_vertices().with_normals(), views


@pytest.mark.parametrize("overhangs", [True, False])
def test_what_photos_look_through_is_told_from_what_stands_on_the_plane(overhangs):
    mesh, views = photographed(solid(overhangs))
    for bottom in (0.0, -0.5):  # the plane is known to half a millimetre or so
        whole, underside = close_underside(mesh, UP, bottom)
        assert underside.state == "closed" and underside.faces
        assert fills_open_space(whole, underside.first_face, views) == overhangs


def test_one_wrong_mask_does_not_tell_open_space():
    mesh, views = photographed(solid(False))
    views[0] = MaskedView(views[0].camera, views[0].image_path, None, np.zeros_like(views[0].mask()))
    whole, underside = close_underside(mesh, UP, 0.0)
    assert not fills_open_space(whole, underside.first_face, views)


@pytest.mark.slow
def test_the_step_leaves_the_space_below_the_ends_open(tmp_path, monkeypatch):
    mesh, views = photographed(solid(True))
    monkeypatch.setattr(close, "read_views", lambda _: (views, None))
    monkeypatch.setattr(watertight, "COARSE", 64)  # an eighth of the voxels
    monkeypatch.setattr(watertight, "FINE", 128)
    write_ply(tmp_path / "clean.ply", mesh)
    write_json(tmp_path / "height.json", {"up": UP.tolist(), "bottom": 0.0, "up_source": "support_plane", "up_uncertainty": {}})
    words = ["--method", "close", "--mesh", tmp_path / "clean.ply", "--height", tmp_path / "height.json"]
    words += ["--cameras", tmp_path / "cameras", "--hollows", "kept", "--out", tmp_path / "closed.ply"]
    assert stage_main("zeroshop_steps.finish", [str(word) for word in words]) == 0
    assert read_json(tmp_path / "closed.json")["closing"]["method"] == "volume"
    closed = read_ply(tmp_path / "closed.ply").as_trimesh()
    flat, _ = close_underside(mesh, UP, 0.0)
    true = solid(True).volume
    assert closed.is_watertight and abs(closed.volume / true - 1) < 0.05 < flat.as_trimesh().volume / true - 1
