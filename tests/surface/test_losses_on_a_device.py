"""Losses of tensors on a device take nothing from the host: shown with PyTorch's device without memory, which refuses a mixture."""

import numpy as np
import pytest
import torch

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.svraster import train as voxels
from zeroshop_steps.surface.svraster.render import Rendering as VoxelRendering
from zeroshop_steps.surface.svraster.settings import VoxelSettings
from zeroshop_steps.surface.training.losses import depth_loss
from zeroshop_steps.surface.training.pass_light import PassLight
from zeroshop_steps.surface.training.trainer import ViewPyramid
from zeroshop_steps.surface.twodgs import train as surfels
from zeroshop_steps.surface.twodgs.render import Rendering as SurfelRendering
from zeroshop_steps.surface.twodgs.settings import SurfelSettings

META, HEIGHT_PX, WIDTH_PX = torch.device("meta"), 20, 30


def make_view(pass_number: int) -> TrainingView:
    k = np.array([[30.0, 0, 15], [0, 30.0, 10], [0, 0, 1]])
    camera = Camera("view", WIDTH_PX, HEIGHT_PX, k, np.eye(4))
    plane = torch.rand(HEIGHT_PX, WIDTH_PX)
    return TrainingView(camera, torch.rand(3, HEIGHT_PX, WIDTH_PX), plane, plane > 0.1, np.ones((2, 2), bool), plane, pass_number)


def make_rendering(kind: type, singles: int) -> SurfelRendering | VoxelRendering:
    shapes = [(3, HEIGHT_PX, WIDTH_PX), (HEIGHT_PX, WIDTH_PX), (3, HEIGHT_PX, WIDTH_PX), *[(HEIGHT_PX, WIDTH_PX)] * singles]
    return kind(*(torch.rand(shape, device=META, requires_grad=True) for shape in shapes), None)


@pytest.mark.parametrize("pass_number", [1, 2])
@pytest.mark.parametrize(
    ("optimizer", "settings", "kind", "singles"),
    [(surfels, SurfelSettings(lambda_distortion=1.0), SurfelRendering, 3), (voxels, VoxelSettings(), VoxelRendering, 4)],
)
def test_losses_and_the_light_of_passes_need_nothing_from_the_host(optimizer, settings, kind, singles, pass_number):
    host = make_view(pass_number)
    view, rendering = ViewPyramid([host], [host]).to(META).fine[0], make_rendering(kind, singles)
    light = PassLight.for_views([view])
    light.learn(rendering, view)
    terms = optimizer.view_loss(rendering, light.relight(rendering, view), settings, with_normals=True)
    pixels, depths, weights = torch.zeros(5, dtype=torch.int64, device=META), *torch.ones(2, 5, device=META)
    terms["depth"] = depth_loss(rendering, pixels, depths, weights, view.active.sum())
    sum(terms.values()).backward()
    assert rendering.color.grad.device == rendering.depth.grad.device == META
    with pytest.raises((RuntimeError, NotImplementedError)):  # what shows that a mixture is refused
        optimizer.view_loss(rendering, host, settings, with_normals=True)
