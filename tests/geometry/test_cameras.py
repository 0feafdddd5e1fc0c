"""Cameras on disk, at another size, and the similarity between two sets of points."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zeroshop_steps.geometry.cameras.pinhole import Camera, fit_similarity, read_sparse_model, write_cameras
from zeroshop_steps.runtime.errors import StepError


def test_cameras_survive_the_disk(tmp_path: Path) -> None:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1.0, 2.0, 3.0]
    camera = Camera("b.png", 640, 480, np.array([[500.0, 0, 320.5], [0, 510.0, 240.25], [0, 0, 1]]), pose)
    write_cameras(tmp_path / "sparse", [camera])
    back = read_sparse_model(tmp_path / "sparse").cameras[0]
    assert back.name == "b.png" and np.allclose(back.intrinsics, camera.intrinsics) and np.allclose(back.camera_from_world, pose)
    with pytest.raises(StepError, match="holds no readable COLMAP model"):
        read_sparse_model(tmp_path / "absent")


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 100.0))
def test_similarity_is_recovered_exactly(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    source, shift = rng.normal(size=(8, 3)), rng.normal(size=3) * 10
    found = fit_similarity(source, scale * source @ rotation.T + shift)
    assert np.allclose(found[:3, :3], scale * rotation, atol=1e-9 * scale + 1e-12)
    assert np.allclose(found[:3, 3], shift, atol=1e-8 * (1 + scale))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_resized_cameras_see_the_same_rays(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = Camera("a", 800, 600, np.array([[700.0, 0, 390], [0, 705, 310], [0, 0, 1]]), np.eye(4))
    points = np.concatenate([rng.uniform(-1, 1, (5, 2)), rng.uniform(2, 4, (5, 1))], 1)
    pixels, depths = camera.project(points)
    small, small_depths = camera.resized(400, 150).project(points)
    assert np.allclose(small, pixels * [0.5, 0.25]) and np.allclose(depths, small_depths)
