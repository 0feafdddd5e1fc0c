"""Stereo on the ball, and the file of its seeds."""

import dataclasses
import filecmp
from pathlib import Path

import numba
import numpy as np
import pytest
import torch

from helpers.ball import FOCAL_PX, RADIUS, SIZE_PX, ball_views
from zeroshop_steps.geometry.cameras.object_crops import STRIDE_PX, ObjectSphere
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.mvs.depth_consistency import find_seeds
from zeroshop_steps.surface.mvs.patchmatch import estimate_depth_maps
from zeroshop_steps.surface.mvs.seeds import Seeds, read_seeds, write_seeds
from zeroshop_steps.surface.rendering.training_views import TrainingView, make_grid_view

SPHERE = ObjectSphere(np.array([10.0, -20.0, 5.0]), 80.0)


def cameras_of(views: list[TrainingView]) -> list[Camera]:
    return [view.camera for view in views]


def some_seeds(views: list[TrainingView]) -> Seeds:
    rng = np.random.default_rng(0)
    maps = {view.camera.name: rng.uniform(0, 3, make_grid_view(view).mask.shape).astype(np.float32) for view in views}
    return Seeds(*(rng.normal(size=(50, 3)) for _ in range(3)), maps, VisualHull(rng.random((16, 16, 16)) > 0.5, 1.0))


@pytest.mark.slow
def test_stereo_finds_the_surface_and_its_normals() -> None:
    enlarged = 2
    views, depths = ball_views(enlarged * SIZE_PX, fineness=2.0)
    hull = VisualHull.carve([view.camera for view in views], [view.mask.numpy() > 0 for view in views], 1.0, 48, misses_allowed=1)
    seeds, _ = find_seeds(views, hull, seed=0)
    radius = np.linalg.norm(seeds.positions, axis=1)
    assert len(seeds.positions) > 500
    exact = 0.5 * 2.5 / (enlarged * FOCAL_PX)  # half a pixel at the ball's distance
    assert np.median(np.abs(radius - RADIUS)) < exact
    assert np.quantile(((seeds.positions / radius[:, None]) * seeds.normals).sum(1), 0.1) > 0.8
    errors = []
    for view, found, true_depth in zip(views, seeds.depth_maps.values(), depths, strict=True):
        expected = true_depth[::STRIDE_PX, ::STRIDE_PX]
        assert found.shape == make_grid_view(view).mask.shape
        errors.append(np.abs(found - expected)[(found > 0) & (expected > 0)])
    assert np.median(np.concatenate(errors)) < exact, "depths belong to the pixels of the grid view"
    assert seeds.carved_hull.occupied.sum() <= hull.occupied.sum()


def test_stereo_gives_the_same_whatever_the_number_of_threads(ball: tuple) -> None:
    views, _ = ball
    occupied = VisualHull.carve([view.camera for view in views], [view.mask.numpy() > 0 for view in views], 1.0, 48).occupied
    one = estimate_depth_maps(views[:5], occupied, 1.0, seed=3, photometric_rounds=1, geometric_rounds=1)
    numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
    try:
        two = estimate_depth_maps(views[:5], occupied, 1.0, seed=3, photometric_rounds=1, geometric_rounds=1)
    finally:
        numba.set_num_threads(1)
    for first, second in zip(one, two, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_grid_view_sees_what_every_third_pixel_sees(ball: tuple) -> None:
    view = ball[0][3]
    small = make_grid_view(view)
    point = np.array([[0.1, -0.2, 0.3]])
    pixel, small_pixel = view.camera.project(point)[0][0], small.camera.project(point)[0][0]
    # The centre of the grid's pixel i is the centre of the image's pixel STRIDE_PX * i.
    assert np.allclose((pixel - 0.5) / STRIDE_PX, small_pixel - 0.5)
    assert torch.equal(small.color, view.color[:, ::STRIDE_PX, ::STRIDE_PX])


def test_a_file_of_seeds_keeps_everything_and_the_same_bytes(ball: tuple, tmp_path: Path) -> None:
    views, seeds = ball[0], some_seeds(ball[0])
    write_seeds(tmp_path / "seeds.npz", seeds, SPHERE)
    back = read_seeds(tmp_path / "seeds.npz", SPHERE, cameras_of(views))
    for name in ("positions", "colors", "normals"):
        assert np.array_equal(getattr(back, name), getattr(seeds, name)), name
    assert list(back.depth_maps) == list(seeds.depth_maps)
    assert all(np.array_equal(back.depth_maps[name], depth) for name, depth in seeds.depth_maps.items())
    assert np.array_equal(back.carved_hull.occupied, seeds.carved_hull.occupied) and back.carved_hull.half_extent == 1.0
    write_seeds(tmp_path / "again.npz", back, SPHERE)
    assert filecmp.cmp(tmp_path / "seeds.npz", tmp_path / "again.npz", shallow=False)


def test_seeds_may_be_none(ball: tuple, tmp_path: Path) -> None:
    empty = np.zeros((0, 3))
    write_seeds(tmp_path / "seeds.npz", dataclasses.replace(some_seeds(ball[0]), positions=empty, colors=empty, normals=empty), SPHERE)
    assert read_seeds(tmp_path / "seeds.npz", SPHERE, cameras_of(ball[0])).positions.shape == (0, 3)


@pytest.mark.parametrize("damage", ["cut", "changed", "mixed", "text"])
def test_a_damaged_file_of_seeds_is_named(ball: tuple, tmp_path: Path, damage: str) -> None:
    path, seeds = tmp_path / "seeds.npz", some_seeds(ball[0])
    if damage == "mixed":
        seeds = dataclasses.replace(seeds, colors=seeds.colors[:-1])
    write_seeds(path, seeds, SPHERE)
    content = path.read_bytes()
    if damage == "cut":
        path.write_bytes(content[:-100])
    elif damage == "changed":
        middle = len(content) // 2
        path.write_bytes(content[:middle] + bytes(byte ^ 255 for byte in content[middle : middle + 20]) + content[middle + 20 :])
    elif damage == "text":
        path.write_text("no archive")
    with pytest.raises(StepError, match="seeds.npz is not a whole file of seeds.*run stereo again"):
        read_seeds(path, SPHERE, cameras_of(ball[0]))


def test_seeds_of_other_images_or_cameras_are_refused(ball: tuple, tmp_path: Path) -> None:
    path, views = tmp_path / "seeds.npz", ball[0]
    with pytest.raises(StepError, match="seeds.npz does not exist; run stereo first"):
        read_seeds(path, SPHERE, cameras_of(views))
    write_seeds(path, some_seeds(views), SPHERE)
    for sphere, others in ((SPHERE, views[:-1]), (ObjectSphere(SPHERE.centre + 0.01, SPHERE.radius), views)):
        with pytest.raises(StepError, match="seeds.npz belongs to other images or cameras"):
            read_seeds(path, sphere, cameras_of(others))
