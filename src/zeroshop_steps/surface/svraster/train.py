"""Training of sparse voxels (Sun et al. 2025) on the cropped views of one object."""

import math
from typing import Any

import numpy as np
import torch

from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.svraster.octree import MAX_LEVEL, Octree
from zeroshop_steps.surface.svraster.render import Rendering, RenderView, render
from zeroshop_steps.surface.svraster.renderers import make_renderer
from zeroshop_steps.surface.svraster.settings import VoxelSettings
from zeroshop_steps.surface.svraster.voxels import Voxels
from zeroshop_steps.surface.training.initialization import Initialization
from zeroshop_steps.surface.training.losses import SOLID_ALPHA, has_normal, image_losses, normal_mismatch, normals_from_depth
from zeroshop_steps.surface.training.optimizer import ResizableAdam
from zeroshop_steps.surface.training.trainer import Trainer, ViewPyramid

LEARNING_RATES = {"densities": 0.1, "sh_constant": 0.01, "sh_rest": 0.01 / 20}
BETAS = (0.9, 0.99)
"""Of Adam. Rates and betas were tuned on the demo mustard bottle."""
SOLID_DENSITY = 2.0
"""Mean density, before activation, from which a leaf counts as the inside of the object."""
SPLIT_PX = 1.5
"""A leaf whose edge covers fewer pixels than this has nothing to gain from being split."""
RATE_FALL = 0.1
"""The learning rate at the end, as a share of that at the beginning; it falls exponentially."""


class VoxelMeter:
    """For each voxel, over the images since the last change: its largest blending weight, and its priority for subdivision."""

    def __init__(self, count: int, device: torch.device | None = None) -> None:
        self.weight, self.priority = torch.zeros(2, count, device=device)

    def add(self, weight: torch.Tensor, priority: torch.Tensor) -> None:
        """Count one view: (N,) largest weights and (N,) sums of |alpha d loss / d alpha|."""
        torch.maximum(self.weight, weight, out=self.weight)
        self.priority += priority


def prune_and_subdivide(
    voxels: Voxels, optimizer: ResizableAdam, keep: np.ndarray, priority: np.ndarray, max_level: int, count_max: int
) -> None:
    """Drop leaves, and split those with the highest priority into eight, which take over density, colour and the optimizer's moments.

    Args:
        keep: (N,) bool.
        priority: (N,) leaves with a larger one are split first, those of zero never.
        max_level: leaves of this level are not split.
        count_max: no more leaves than this after the change, unless more are kept.
    """
    old = voxels.octree
    wanted = keep & (priority > 0) & (old.levels < min(max_level, MAX_LEVEL))
    room = max(count_max - int(keep.sum()), 0) // 7
    if int(wanted.sum()) > room:
        urgent = np.argsort(np.where(wanted, -priority, np.inf), kind="stable")[:room]
        wanted = np.zeros(len(old), bool)
        wanted[urgent] = True
    new, source = old.refine(keep, wanted)

    def at_corners(values: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(old.interpolate(values.cpu().numpy(), new, source)).to(values.device)

    rows = torch.from_numpy(source).to(voxels.densities.device)
    optimizer.replace_tensor("densities", at_corners, at_corners)
    for name in ("sh_constant", "sh_rest"):
        optimizer.replace_tensor(name, lambda values: values[rows], lambda moment: moment[rows])
    voxels.octree = new


def view_loss(rendering: Rendering, view: TrainingView, settings: VoxelSettings, with_normals: bool) -> dict[str, torch.Tensor]:
    """The weighted terms of the loss, each a mean over the view's active pixels (Sun et al. 2025, sec. 3.3 and supplement).

    L1 and D-SSIM of the colour, and L1 of the opacity against the mask. With T the transmittance at a ray's end and w the
    blending weights: T^2 (1 - T)^2, so that a pixel is full or empty; w |c - C|^2, so that everything on a ray has the photo's
    colour C; w max(cos, 0) of normals that face away, so that density rises along the ray. Finally, normal consistency.
    """
    terms = image_losses(rendering, view, settings.lambda_dssim, settings.lambda_mask)
    counted = view.counted
    pixels = counted.sum()
    clear = (rendering.alpha * (1 - rendering.alpha)).square()
    terms["transmittance"] = settings.lambda_transmittance * (clear * counted).sum() / pixels
    spread = rendering.color_square - 2 * (rendering.color * view.color).sum(0) + rendering.alpha * view.color.square().sum(0)
    terms["color"] = settings.lambda_color * (spread * counted).sum() / pixels
    terms["away"] = settings.lambda_ascending * (rendering.away * counted).sum() / pixels
    if with_normals:
        k = view.camera.intrinsics
        surface = normals_from_depth(rendering.median_depth, k[0, 0], k[1, 1], k[0, 2], k[1, 2])
        solid = view.active & has_normal(rendering.median_depth) & (rendering.alpha.detach() > SOLID_ALPHA)
        terms["normal"] = settings.lambda_normal * normal_mismatch(rendering, surface, solid) / pixels
    return terms


class VoxelTrainer(Trainer[Voxels, Rendering, VoxelSettings]):
    """Training of sparse voxels, with pruning and subdivision."""

    title, primitives, count_name = "SVRaster", "voxels", "voxels"
    learning_rates, betas = LEARNING_RATES, BETAS

    def __init__(self, model: Voxels, views: ViewPyramid, initialization: Initialization, settings: VoxelSettings) -> None:
        self.renderer = make_renderer(settings.device)
        super().__init__(model, views, initialization, settings, self.renderer.device)
        self.reset_meter()

    def reset_meter(self) -> None:
        """Forget what the views have said of the voxels."""
        self.meter, self.rendered_views = VoxelMeter(len(self.model), self.device), set[int]()

    def make_render_view(self, view: TrainingView) -> RenderView:
        return RenderView.from_training_view(view)

    def render(self, index: int, degree: int) -> Rendering:
        v = self.model
        sh = torch.cat([v.sh_constant, v.sh_rest], dim=1)
        return render(v.octree, v.densities, sh, degree, self.render_views[index], self.renderer)

    def view_loss(self, rendering: Rendering, view: TrainingView, with_normals: bool) -> dict[str, torch.Tensor]:
        return view_loss(rendering, view, self.settings, with_normals)

    def update_model(self, rendering: Rendering, index: int, share: float) -> None:
        self.meter.add(rendering.statistics.weight, rendering.statistics.priority)
        self.rendered_views.add(index)
        for name, rate in LEARNING_RATES.items():
            self.optimizer.set_learning_rate(name, rate * RATE_FALL**share)
        self.optimizer.step()

    def adapt_model(self) -> None:
        settings = self.settings
        if self.iteration not in [math.ceil(share * settings.iterations) for share in settings.adapt_shares]:
            return
        self._count_remaining_views()
        octree = self.model.octree
        # What is dense and hidden stays: otherwise a ray through a thin spot would reach the far wall, and no view would notice.
        weight, priority, densities = (
            values.detach().cpu().numpy() for values in (self.meter.weight, self.meter.priority, self.model.densities)
        )
        solid = densities[octree.corners].mean(axis=1) > SOLID_DENSITY
        keep = (weight > settings.weight_min) | solid
        wanted = np.where(octree.sizes > SPLIT_PX * self._pixel_size(octree), priority * octree.sizes, 0.0)
        prune_and_subdivide(self.model, self.optimizer, keep, wanted, settings.level_max, settings.count_max)
        self.reset_meter()

    def _count_remaining_views(self) -> None:
        """Count the weights in the views that were not drawn since the last change, so that no voxel is dropped that one of them needs."""
        for index in sorted(set(range(len(self.views))) - self.rendered_views):
            rendering = self.render(index, 0)
            rendering.alpha.sum().backward()
            self.meter.add(rendering.statistics.weight, torch.zeros_like(self.meter.priority))
        self.optimizer.adam.zero_grad(set_to_none=True)

    def _pixel_size(self, octree: Octree) -> np.ndarray:
        """(N,) edge of a pixel at each leaf's depth, in normalized units: the least over the views in use."""
        sizes = [view.camera.project(octree.centres)[1] / view.camera.intrinsics[0, 0] for view in self.views]
        return np.min(sizes, axis=0)

    def extra_state(self) -> dict[str, Any]:
        octree = self.model.octree
        leaves = (torch.from_numpy(octree.origins), torch.from_numpy(octree.levels))
        return {
            "leaves": leaves,
            "meter": (self.meter.weight, self.meter.priority),
            "rendered_views": sorted(self.rendered_views),
        }

    def restore_extra_state(self, content: dict[str, Any]) -> None:
        self.meter.weight, self.meter.priority = (tensor.to(self.device) for tensor in content["meter"])
        self.rendered_views = set(content["rendered_views"])

    @classmethod
    def from_checkpoint(
        cls, content: dict[str, Any], views: ViewPyramid, initialization: Initialization, settings: VoxelSettings
    ) -> "VoxelTrainer":
        octree = Octree(*(tensor.numpy() for tensor in content["leaves"]))
        return cls(Voxels(octree, **content["tensors"]), views, initialization, settings)
