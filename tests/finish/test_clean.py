from pathlib import Path

import numpy as np
import pytest
import trimesh

from helpers.solids import as_trimesh
from zeroshop_steps.finish.clean import clean_mesh, drop_floaters
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.meshes.mesh_repair import label_parts
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError


def ball(radius: float, centre=(0.0, 0.0, 0.0), subdivisions: int = 3) -> Mesh:
    sphere = trimesh.creation.icosphere(subdivisions, radius)
    return Mesh(np.array(sphere.vertices) + centre, np.array(sphere.faces, np.int64))


def joined(*meshes: Mesh) -> Mesh:
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)])
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), faces)


@pytest.fixture(scope="module")
def views(carton):
    return read_views(carton.cameras)[0]


def test_floaters_go_by_their_size_beside_the_largest_part(views):
    mesh, dropped = drop_floaters(joined(ball(15.0), ball(2.0, (0.0, 0.0, 30.0)), ball(8.0, (0.0, 0.0, -30.0))), views, 0.05)
    assert dropped == {"small": 1, "unseen": 0}
    assert label_parts(mesh.faces).max() == 1


def test_a_part_inside_another_is_not_seen_and_goes(views):
    mesh, dropped = drop_floaters(joined(ball(15.0), ball(10.0)), views, 0.05)
    assert dropped["unseen"] == 1
    assert np.linalg.norm(mesh.vertices, axis=1).min() > 14.0


@pytest.mark.parametrize("radius", [0.5, 3.0, 15.0])
def test_a_small_or_coarse_object_stays(views, radius):
    mesh, _ = clean_mesh(ball(radius, subdivisions=1), views, smooth=0)
    assert len(mesh.faces) == 80


def test_what_lies_outside_the_masks_goes(views):
    mesh, _ = clean_mesh(joined(ball(15.0), ball(14.0, (0.0, 70.0, 0.0))), views, smooth=0)
    assert np.abs(mesh.vertices[:, 1]).max() < 20.0


def test_a_surface_from_small_images_is_cut_no_finer_than_its_faces(carton, views):
    """It may lie beyond the masks by less than it resolves; a fine one that lies as far beyond them is wrong there."""
    low, high = carton.mesh.vertices.min(0), carton.mesh.vertices.max(0)
    for times, whole in ((2, True), (5, False)):
        box = trimesh.creation.box(bounds=[low - 4.0, high + 4.0])
        for _ in range(times):
            box = box.subdivide()
        mesh, _ = clean_mesh(Mesh(np.array(box.vertices), np.array(box.faces)), views, smooth=0)
        assert (len(mesh.faces) == len(box.faces)) == whole


def test_light_smoothing_removes_noise_and_does_not_shrink(views):
    noisy = ball(18.0, subdivisions=4)
    noisy = Mesh(noisy.vertices + np.random.default_rng(0).normal(0.0, 0.1, noisy.vertices.shape), noisy.faces)
    mesh, _ = clean_mesh(noisy, views, smooth=5)
    radius = np.linalg.norm(mesh.vertices, axis=1)
    assert radius.std() < 0.06
    assert radius.mean() == pytest.approx(18.0, abs=0.03)


def test_small_holes_close_and_faces_stay_below_the_limit(views):
    sphere = ball(18.0, subdivisions=5)
    holed = Mesh(sphere.vertices, np.delete(sphere.faces, [5, 300, 301], axis=0))
    mesh, _ = clean_mesh(holed, views, max_faces=5000)
    assert as_trimesh(mesh).is_watertight
    assert len(mesh.faces) <= 5000
    assert as_trimesh(mesh).volume == pytest.approx(4 / 3 * np.pi * 18.0**3, rel=0.01)


def test_an_inverted_surface_is_turned_outwards(views):
    sphere = ball(18.0)
    mesh, _ = clean_mesh(Mesh(sphere.vertices, sphere.faces[:, ::-1].copy()), views)
    assert as_trimesh(mesh).volume > 0


def test_duplicate_and_degenerate_faces_go(views):
    sphere = ball(18.0)
    faces = np.concatenate([sphere.faces, sphere.faces[:50], sphere.faces[:20, [1, 2, 0]], np.full((3, 3), 7)])
    mesh, _ = clean_mesh(Mesh(sphere.vertices, faces), views, smooth=0)
    assert len(mesh.faces) == len(sphere.faces)


@pytest.mark.slow
def test_the_same_input_gives_the_same_mesh(views):
    first, second = (clean_mesh(ball(18.0, subdivisions=5), views, max_faces=3000)[0] for _ in range(2))
    assert np.array_equal(first.vertices, second.vertices) and np.array_equal(first.faces, second.faces)


@pytest.mark.parametrize(
    "content", [b"", b"ply\nformat binary_little_endian 1.0\nelement vertex 3\n", b"ply\nformat ascii 1.0\nend_header\n"]
)
def test_a_damaged_or_empty_ply_is_a_clear_error(tmp_path: Path, content: bytes):
    path = tmp_path / "raw_mesh.ply"
    path.write_bytes(content)
    with pytest.raises(StepError, match="raw_mesh.ply"):
        read_ply(path)
