"""The light of a later pass is learned, and taken out of its photos."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from helpers.ball import RADIUS, ball_views
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.training.pass_light import PassLight, light_basis

SIZE_PX = 48


def normals_of(view: TrainingView, depth: np.ndarray) -> torch.Tensor:
    """(3, H, W) of the ball in the camera frame, times the mask."""
    k, pose = view.camera.intrinsics, view.camera.camera_from_world
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX] + 0.5
    points = np.stack([(x - k[0, 2]) / k[0, 0] * depth, (y - k[1, 2]) / k[1, 1] * depth, depth])
    normals = (points - pose[:3, 3][:, None, None]) / RADIUS  # the ball's centre is the origin
    return torch.from_numpy((normals * (depth > 0)).astype(np.float32))


def in_other_light(view: TrainingView, normals: torch.Tensor, coefficients: torch.Tensor) -> TrainingView:
    """The view as a photo of pass 2; the light depends on normals in the world."""
    world_from_camera = torch.from_numpy(view.camera.camera_from_world[:3, :3].T.astype(np.float32))
    factors = (coefficients.T @ light_basis(world_from_camera @ normals.reshape(3, -1))).exp().reshape(3, SIZE_PX, SIZE_PX)
    return replace(view, color=view.color * factors, pass_number=2)


@pytest.fixture(scope="module")
def scene() -> tuple[list[TrainingView], list[SimpleNamespace], list[TrainingView]]:
    """Photos of the first pass, perfect renderings of them, and the same photos in the light of a second pass."""
    views, depths = ball_views(SIZE_PX)
    coefficients = torch.zeros(9, 3)
    coefficients[3] = torch.tensor([-0.4, -0.35, -0.3])  # lit from below
    coefficients[1], coefficients[8] = 0.1, -0.05
    normals = [normals_of(view, depth) for view, depth in zip(views, depths, strict=True)]
    renderings = [SimpleNamespace(color=view.color, alpha=view.mask, normal=normal) for view, normal in zip(views, normals, strict=True)]
    lit = [in_other_light(view, normal, coefficients) for view, normal in zip(views, normals, strict=True)]
    return views, renderings, lit


def test_the_photos_of_a_later_pass_come_into_the_light_of_the_first(scene):
    views, renderings, lit = scene
    light = PassLight.for_views(views + lit)
    for _ in range(3):
        for rendering, view in zip(renderings, lit, strict=True):
            light.learn(rendering, view)
    before = max(float((one.color - other.color).abs().max()) for one, other in zip(views, lit, strict=True))
    pairs = zip(views, renderings, lit, strict=True)
    after = max(float((one.color - light.relight(rendering, other).color).abs().max()) for one, rendering, other in pairs)
    assert before > 0.2 and after < 0.01


def test_photos_of_the_first_pass_stay_as_they_are(scene):
    views, renderings, lit = scene
    light = PassLight.for_views(views + lit)
    light.learn(renderings[0], views[0])
    assert not light.coefficients.any() and light.relight(renderings[0], views[0]) is views[0]


def test_a_checkpoint_goes_on_with_the_same_bytes(scene):
    views, renderings, lit = scene
    straight, resumed = PassLight.for_views(lit), PassLight.for_views(lit)
    straight.learn(renderings[0], lit[0])
    resumed.restore(straight.state())
    for light in (straight, resumed):
        light.learn(renderings[1], lit[1])
    assert torch.equal(straight.coefficients, resumed.coefficients)
