"""The mesh for FoundationPose is in metres, centred, and finds its texture."""

import numpy as np
import trimesh

from helpers.faults import step
from helpers.small_bodies import BOX_MM, make_box, write_product


def test_it_is_in_metres_and_centred(tmp_path):
    mesh = write_product(tmp_path / "2dgs.ply", trimesh.creation.box(BOX_MM))
    assert step("assets", "foundationpose", mesh=mesh, out=tmp_path / "fp") == 0
    # As its demo reads it.
    loaded = trimesh.load(tmp_path / "fp/mesh/textured_simple.obj")
    _, extents = trimesh.bounds.oriented_bounds(loaded)
    assert np.allclose(np.sort(extents), np.sort(BOX_MM) / 1000) and np.allclose(loaded.bounds.mean(0), 0, atol=1e-6)
    assert loaded.visual.material.image.size == (32, 32)


def test_a_mesh_off_its_origin_is_refused(tmp_path, capsys):
    assert step("assets", "foundationpose", mesh=write_product(tmp_path / "2dgs.ply", make_box()), out=tmp_path / "fp") == 1
    assert "is not centred" in capsys.readouterr().err
