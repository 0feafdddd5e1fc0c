"""What a plane costs, against the same views asked one by one: bounds may save work, and nothing else."""

import numpy as np
import pytest

from helpers.ball import ball_view
from zeroshop_steps.geometry.cameras.object_crops import STRIDE_PX
from zeroshop_steps.surface.mvs.patch_cost import (
    COST_MAX,
    PATCH_SIDE,
    PLACE_WIDTH,
    facing_normal,
    fill_reference_patch,
    plane_cost,
)

SIZE_PX = 192
NO_LIMIT = 10.0


@pytest.fixture(scope="module")
def scene() -> tuple:
    """Seven views of the ball for the kernels, with depths and normals at the grid's pixels as the second round has them."""
    pairs = [
        ball_view(azimuth, elevation, SIZE_PX, 3.0)
        for azimuth, elevation in zip(range(0, 140, 20), [-20, 15, 0, 25, -5, 10, 30], strict=True)
    ]
    views, depths = zip(*pairs, strict=True)
    rows = np.array([view.camera.row for view in views])
    color = np.stack([view.color.numpy().transpose(1, 2, 0) for view in views])
    masks = np.stack([view.mask.numpy() > 0 for view in views])
    detail = (color.mean(axis=3) - 0.5).astype(np.float32)
    sizes = np.full((len(views), 2), SIZE_PX)
    found_depth = np.stack(depths)[:, ::STRIDE_PX, ::STRIDE_PX].astype(np.float32)
    found_normal = np.zeros((*found_depth.shape, 3), np.float32)
    found_normal[..., 2] = -1.0
    return (rows, color, detail, masks, sizes), np.stack(depths), (found_depth, found_normal)


def cost(scene: tuple, found: tuple, neighbours: np.ndarray, x: int, y: int, z: float, normal: np.ndarray, limit: float) -> float:
    rows, color, detail, masks, sizes = scene
    arrays = (rows, neighbours, color, detail, masks, sizes)
    patch, weight = np.empty((2, PATCH_SIDE, PATCH_SIDE), np.float32)
    statistics = fill_reference_patch(0, arrays, y, x, patch, weight)
    dx, dy = (x + 0.5 - rows[0, 14]) / rows[0, 12], (y + 0.5 - rows[0, 15]) / rows[0, 13]
    normal = facing_normal(dx, dy, *normal)
    places = np.empty((neighbours.shape[1], PLACE_WIDTH))
    return plane_cost(0, arrays, *found, y, x, patch, weight, *statistics, places, dx, dy, z, *normal, limit)


@pytest.mark.parametrize("second_round", [False, True])
def test_a_plane_costs_what_its_best_views_say_one_by_one(scene: tuple, second_round: bool) -> None:
    arrays, depths, found = scene
    if not second_round:
        found = (np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 1, 3), np.float32))
    rng = np.random.default_rng(0)
    others = np.arange(1, len(depths))
    rows = np.zeros((1, len(others)), np.int64) + others
    seen = rejected = 0
    for _ in range(300):
        y, x = rng.integers(60, SIZE_PX - 60, 2)
        z = depths[0, y, x] * (1 + rng.normal() * rng.choice([0.0, 0.003, 0.1]))
        normal = np.array([0, 0, -1.0]) + rng.normal(size=3) * rng.choice([0.0, 0.3])
        single = sorted(cost(arrays, found, np.full((1, 1), n), x, y, z, normal, NO_LIMIT) for n in others)
        expected = np.mean(single[:2])
        assert cost(arrays, found, rows, x, y, z, normal, NO_LIMIT) == pytest.approx(expected, abs=1e-9)
        limit = rng.uniform(0, 1)
        bounded = cost(arrays, found, rows, x, y, z, normal, limit)
        if expected < limit:
            seen += 1
            assert bounded == pytest.approx(expected, abs=1e-9)
        else:
            rejected += bounded == COST_MAX
            assert bounded >= limit
    assert seen > 50 and rejected > 20
