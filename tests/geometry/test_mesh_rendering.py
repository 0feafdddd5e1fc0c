"""What cameras see of a mesh: rasterized, as rays find it, on the processor and on CUDA (in Numba's simulator, and on a device)."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from helpers import drawn_boxes
from helpers.simulator import run_in_simulator
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.compute.kernel_devices import has_cuda

INSIDE_MM, BEFORE_MM, BESIDE_MM = (0.0, 0.0, 0.0), (5.0, -4.0, 260.0), (900.0, 0.0, 260.0)


@pytest.mark.parametrize("away_mm", [BEFORE_MM, INSIDE_MM, BESIDE_MM])
def test_cameras_see_what_rays_hit(away_mm):
    mesh = drawn_boxes.make_boxes()
    renderer, seen = MeshRenderer(mesh), 0
    for camera in drawn_boxes.make_cameras(away_mm, 5):
        (face, barycentric, depth), hits = drawn_boxes.cast(mesh, camera), renderer.cast_rays(camera)
        np.testing.assert_array_equal(hits.mask, face >= 0)
        np.testing.assert_allclose(hits.depth, depth, rtol=1e-5)
        same = hits.mask & (hits.face == face)
        assert same.sum() >= 0.99 * hits.mask.sum(), "of two faces that meet at a pixel's centre, either is right"
        np.testing.assert_allclose(hits.barycentric[same], barycentric[same], atol=1e-4)
        np.testing.assert_array_equal(renderer.find_depth(camera), hits.depth)
        seen += int(same.sum())
    assert (seen == 0) == (away_mm == BESIDE_MM)


def test_large_and_small_faces_leave_no_gap_where_they_meet():
    rng = np.random.default_rng(3)
    plane = np.stack(np.meshgrid(np.arange(24.0), np.arange(24.0)), 2).reshape(-1, 2) + rng.normal(0, 0.2, (576, 2))
    mesh = Mesh(np.column_stack([plane, np.full(len(plane), 40.0)]), Delaunay(plane).simplices.astype(np.int64))
    # Pixels are 1/32 of a unit, so that many centres lie on an edge or at a corner where corners are whole numbers.
    camera = Camera("", 640, 640, np.array([[1280.0, 0, -63.5], [0, 1280.0, -63.5], [0, 0, 1]]), np.eye(4))
    snapped = Mesh(np.column_stack([np.round(plane * 4) / 4, np.full(len(plane), 40.0)]), mesh.faces)
    for drawn in (mesh, snapped):
        assert MeshRenderer(drawn).find_depth(camera)[32:-32, 32:-32].min() > 0


def test_the_window_holds_all_that_is_seen():
    mesh = drawn_boxes.make_boxes()
    renderer = MeshRenderer(mesh)
    for away_mm in (BEFORE_MM, (60.0, 40.0, 300.0), BESIDE_MM):
        for camera in drawn_boxes.make_cameras(away_mm):
            window, part = renderer.find_window(camera)
            whole = renderer.find_depth(camera)
            rest = whole.copy()
            rest[window] = 0
            assert not rest.any() and min(part.width_px, part.height_px) >= 2
            np.testing.assert_array_equal(renderer.find_depth(part), whole[window])


@pytest.mark.slow
def test_the_simulated_kernel_draws_what_the_cpu_draws(tmp_path):
    run_in_simulator(drawn_boxes.__file__, str(tmp_path / "found.npz"))
    found = np.load(tmp_path / "found.npz")
    for name, expected in drawn_boxes.draw("cpu").items():
        np.testing.assert_allclose(found[name], expected, rtol=0, atol=1e-5 if name in ("barycentric", "posed_shares") else 0, err_msg=name)


@pytest.mark.skipif(not has_cuda(), reason="Numba finds no CUDA device")
def test_a_device_draws_what_the_cpu_draws_and_the_same_bytes_twice():
    expected, found, again = (drawn_boxes.draw(device) for device in ("cpu", "cuda", "cuda"))
    assert all(found[name].tobytes() == again[name].tobytes() for name in found)
    assert all((found[name] == expected[name]).mean() > 0.999 for name in ("face", "posed_face"))
    np.testing.assert_allclose(found["depth"], expected["depth"], rtol=1e-5)
