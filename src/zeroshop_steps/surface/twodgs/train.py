"""Training of 2D Gaussian Splatting (Huang et al. 2024) on the cropped views of one object."""

import math
from dataclasses import dataclass
from typing import Any

import torch

from zeroshop_steps.surface.initialization import Initialization
from zeroshop_steps.surface.losses import normals_from_depth
from zeroshop_steps.surface.trainer import Trainer, ViewPyramid, depth_loss, image_losses
from zeroshop_steps.surface.training_views import TrainingView
from zeroshop_steps.surface.twodgs.densify import GradientMeter, ResizableAdam, densify_and_prune, reset_opacity
from zeroshop_steps.surface.twodgs.render import Rendering, RenderView, render
from zeroshop_steps.surface.twodgs.surfels import Surfels


@dataclass(frozen=True)
class SurfelSettings:
    """What a run depends on besides its images; shares of the run are fractions of `iterations`."""

    iterations: int = 800
    sh_degree: int = 2
    seed: int = 0
    lambda_dssim: float = 0.2
    lambda_mask: float = 0.5
    lambda_normal: float = 0.05
    lambda_distortion: float = 0.0
    normal_from_share: float = 0.25
    densify_from_share: float = 0.05
    densify_until_share: float = 0.6
    densify_every: int = 100
    densify_gradient: float = 0.12
    opacity_reset_share: float = 0.2
    opacity_min: float = 0.05
    count_max: int = 40_000
    coarse_share: float = 0.5
    lambda_depth: float = 5.0


SPLIT_SCALE = 0.03
"""Standard deviation, in normalized units, from which a disk is split rather than cloned."""
SCALE_MAX = 0.08
"""Largest standard deviation of a disk, in normalized units: a larger one would bridge hollows."""


LEARNING_RATES = {
    "positions": 6e-4, "log_scales": 5e-3, "quaternions": 1e-3, "opacity_logits": 5e-2, "sh_constant": 2.5e-3, "sh_rest": 2.5e-3 / 20,
}  # fmt: skip
POSITION_RATE_FALL = 0.01
"""The positions' learning rate at the end, as a share of that at the start; it falls exponentially (Kerbl et al. 2023)."""


def view_loss(rendering: Rendering, view: TrainingView, settings: SurfelSettings, with_normals: bool) -> dict[str, torch.Tensor]:
    """The terms of the loss, each a mean over the view's active pixels, weighted.

    Photometric L1 and D-SSIM (Kerbl et al. 2023), L1 of the opacity against the mask, normal consistency and depth
    distortion (Huang et al. 2024, eq. 13 and 14).
    """
    terms = image_losses(rendering, view, settings.lambda_dssim, settings.lambda_mask)
    active = view.active
    pixels = active.sum()
    if with_normals:
        k = view.camera.intrinsics
        depth = rendering.depth / rendering.alpha.clamp(min=1e-3)
        surface = normals_from_depth(depth, k[0, 0], k[1, 1], k[0, 2], k[1, 2]) * rendering.alpha.detach()
        solid = active & (rendering.alpha.detach() > 0.5)
        mismatch = rendering.alpha.detach() - (rendering.normal * surface).sum(0)
        terms["normal"] = settings.lambda_normal * (mismatch * solid).sum() / pixels
        if settings.lambda_distortion:
            terms["distortion"] = settings.lambda_distortion * (rendering.distortion * active).sum() / pixels
    return terms


class SurfelTrainer(Trainer):
    """Disks in training."""

    title, noun = "2DGS", "disks"

    def __init__(self, surfels: Surfels, views: ViewPyramid, initialization: Initialization, settings: SurfelSettings) -> None:
        super().__init__(surfels, ResizableAdam(surfels, LEARNING_RATES), views, initialization, settings)
        self.surfels = surfels
        self.meter = GradientMeter(len(surfels))
        self.generator = torch.Generator().manual_seed(settings.seed)

    def make_render_views(self, views: list[TrainingView]) -> list[RenderView]:
        return [RenderView.from_training_view(view) for view in views]

    def render(self, index: int, degree: int) -> Rendering:
        s = self.surfels
        sh = torch.cat([s.sh_constant, s.sh_rest], dim=1)
        parameters = (s.positions, s.log_scales, s.quaternions, s.opacity_logits, sh)
        return render(*parameters, degree, self.render_views[index], distortion=self.settings.lambda_distortion > 0)

    def losses(self, rendering: Rendering, index: int, share: float) -> dict[str, torch.Tensor]:
        settings, view = self.settings, self.views[index]
        terms = view_loss(rendering, view, settings, share >= settings.normal_from_share)
        terms["depth"] = settings.lambda_depth * depth_loss(rendering, *self.depth_targets[index], view.active.sum())
        return terms

    def update_model(self, rendering: Rendering, index: int, share: float) -> None:
        active = float(self.views[index].active.sum())
        self.meter.add(rendering.statistics.centre_gradient * active, rendering.statistics.visible)
        self.optimizer.set_learning_rate("positions", LEARNING_RATES["positions"] * POSITION_RATE_FALL**share)
        self.optimizer.step()
        with torch.no_grad():
            self.surfels.log_scales.clamp_(max=math.log(SCALE_MAX))

    def adapt_model(self) -> None:
        settings = self.settings
        first, last = settings.densify_from_share * settings.iterations, settings.densify_until_share * settings.iterations
        if first <= self.iteration <= last and self.iteration % settings.densify_every == 0:
            outside = self.initialization.free_space.contains(self.surfels.positions.detach().numpy().astype(float))
            densify_and_prune(
                self.optimizer,
                self.meter,
                threshold=settings.densify_gradient,
                large=SPLIT_SCALE,
                opacity_min=settings.opacity_min,
                doomed=outside,
                count_max=settings.count_max,
                generator=self.generator,
            )
            self.meter = GradientMeter(len(self.surfels))
        every = math.ceil(settings.opacity_reset_share * settings.iterations)
        if self.iteration % every == 0 and self.iteration < last:
            reset_opacity(self.optimizer, 0.1)

    def extra_state(self) -> dict[str, Any]:
        meter = (torch.from_numpy(self.meter.total), torch.from_numpy(self.meter.views))
        return {"meter": meter, "generator": self.generator.get_state()}

    def restore_extra_state(self, content: dict[str, Any]) -> None:
        self.meter.total, self.meter.views = (tensor.numpy() for tensor in content["meter"])
        self.generator.set_state(content["generator"])

    @classmethod
    def from_checkpoint(
        cls, content: dict[str, Any], views: ViewPyramid, initialization: Initialization, settings: SurfelSettings
    ) -> "SurfelTrainer":
        return cls(Surfels(**content["tensors"]), views, initialization, settings)
