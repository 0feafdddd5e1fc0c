"""Meshes of two pipelines side by side: frames and units do not matter, sizes and distances do."""

import numpy as np
import pandas as pd
import pytest
import trimesh

from helpers.camera_ring import ring_camera
from zeroshop_steps.evaluate.compare_meshes import compare_registrations
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.cli import stage_main


def wedge():
    """A body without any symmetry."""
    box = trimesh.creation.box((90, 60, 40)).subdivide().subdivide()
    box.vertices[box.vertices[:, 0] > 20, 2] *= 0.5
    box.vertices[box.vertices[:, 1] > 20, 0] *= 0.8
    return np.asarray(box.vertices, float), np.asarray(box.faces)


def test_a_mesh_that_was_turned_and_scaled_is_the_same(tmp_path):
    vertices, faces = wedge()
    write_ply(tmp_path / "ours.ply", Mesh(vertices, faces))
    turn = trimesh.transformations.rotation_matrix(2.0, (1, 2, 3))[:3, :3]
    trimesh.Trimesh(0.9 * vertices @ turn.T + 50, faces, process=False).export(tmp_path / "theirs.obj")
    words = ["--method", "compare_meshes", "--meshes", str(tmp_path / "ours.ply"), "--out", str(tmp_path / "out.csv")]
    assert stage_main("zeroshop_steps.evaluate", [*words, "--others", str(tmp_path / "theirs.obj")]) == 0
    found = pd.read_csv(tmp_path / "out.csv").set_index("measure").value.astype(float)
    assert found.scale_to_other == pytest.approx(0.9, abs=0.002) and found.mesh_to_other_mm < 0.3
    assert found.mesh_size_x_mm == pytest.approx(90) and found.mesh_faces == found.other_faces == len(faces)


def test_what_cannot_be_paired_or_read_is_refused(tmp_path, capsys):
    vertices, faces = wedge()
    write_ply(tmp_path / "ours.ply", Mesh(vertices, faces))
    (tmp_path / "theirs.xyz").touch()
    (tmp_path / "empty.obj").touch()
    cases = {"give a mesh": ["theirs.xyz", "ours.ply"], "of no format that is read": ["theirs.xyz"], "empty.obj": ["empty.obj"]}
    for words, others in cases.items():
        options = ["--meshes", str(tmp_path / "ours.ply"), "--others", *(str(tmp_path / name) for name in others)]
        assert stage_main("zeroshop_steps.evaluate", ["--method", "compare_meshes", *options, "--out", str(tmp_path / "out.csv")]) == 1
        said = capsys.readouterr().err
        assert words in said and "Traceback" not in said and not (tmp_path / "out.csv").exists()


def test_cameras_of_both_are_compared_in_shares_of_their_spread(tmp_path):
    for place, at in (("ours", (0.0, 0.0, 0.0)), ("theirs", (0.0, 0.0, 20.0))):
        write_cameras(tmp_path / place, [ring_camera(index, 8, 500.0, (10, 40), at, 600.0, (64, 48)) for index in range(8)])
    same, other = (compare_registrations(tmp_path / place, tmp_path / "ours") for place in ("ours", "theirs"))
    assert same["images_of_both"] == 8 and same["centres_apart_share"] < 1e-5 and same["turned_mean_deg"] < 1e-4
    assert other["centres_apart_share"] < 1e-5 and 1.0 < other["turned_mean_deg"] < 4.0
