"""Training of 2D Gaussian Splatting (Huang et al. 2024) on the cropped views of one object."""

import math
from typing import Any

import numpy as np
import torch

from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.training.initialization import Initialization
from zeroshop_steps.surface.training.losses import SOLID_ALPHA, image_losses, normal_mismatch, normals_from_depth
from zeroshop_steps.surface.training.optimizer import ResizableAdam
from zeroshop_steps.surface.training.trainer import Trainer, ViewPyramid
from zeroshop_steps.surface.twodgs.render import Rendering, RenderView, render
from zeroshop_steps.surface.twodgs.renderers import make_renderer
from zeroshop_steps.surface.twodgs.settings import SurfelSettings
from zeroshop_steps.surface.twodgs.surfels import INITIAL_OPACITY, Surfels, rotation_matrices

SPLIT_SHRINKAGE = 1.6
"""The two halves of a split surfel are smaller by this factor (Kerbl et al. 2023)."""
SPLIT_SCALE = 0.03
"""Standard deviation, in normalized units, from which a surfel is split rather than cloned."""
SCALE_MAX = 0.08
"""Largest standard deviation of a surfel, in normalized units. A larger surfel would bridge hollows."""

LEARNING_RATES = {
    "positions": 6e-4, "log_scales": 5e-3, "quaternions": 1e-3, "opacity_logits": 5e-2, "sh_constant": 2.5e-3, "sh_rest": 2.5e-3 / 20,
}  # fmt: skip
"""All but that of the positions are those of Kerbl et al. 2023; theirs falls from 1.6e-4 in units of the scene's extent."""
POSITION_RATE_FALL = 0.01
"""The positions' learning rate at the end, as a share of that at the beginning; it falls exponentially (Kerbl et al. 2023)."""


class GradientMeter:
    """Mean length of each surfel's screen-space gradient over the views that drew it since the last densification."""

    def __init__(self, count: int, device: torch.device | None = None) -> None:
        self.total, self.views = torch.zeros(2, count, dtype=torch.float64, device=device)

    def add(self, gradient: torch.Tensor, visible: torch.Tensor) -> None:
        """Count one view: (N,) lengths of gradients, and (N,) bool, the surfels that were drawn."""
        self.total += gradient * visible
        self.views += visible

    def mean(self) -> torch.Tensor:
        """(N,) means, zero for surfels that no view drew."""
        return self.total / self.views.clamp(min=1)


def densify_and_prune(
    surfels: Surfels, optimizer: ResizableAdam, meter: GradientMeter, threshold: float, large: float, opacity_min: float,
    excluded: torch.Tensor, count_max: int, generator: torch.Generator,
) -> None:  # fmt: skip
    """Clone small surfels and split large ones where the mean gradient exceeds the threshold; drop faint and excluded ones.

    Args:
        threshold: gradient, in loss per pixel of shift summed over the image's pixels.
        large: scale, in normalized units, from which a surfel is split into two rather than cloned.
        opacity_min: surfels fainter than this are dropped.
        excluded: (N,) bool, surfels to drop for other reasons, such as lying in free space.
        count_max: no more surfels than this; where too many exceed the threshold, those with the largest gradients win.
        generator: of the random places of the halves.
    """
    with torch.no_grad():
        scales = surfels.log_scales.exp()
        widest = scales.max(dim=1).values
        faint = torch.sigmoid(surfels.opacity_logits) < opacity_min
        gone = faint | excluded
        gradient = meter.mean()
        gradient[gone] = 0.0
        room = max(count_max - int((~gone).sum()), 0)
        wanted = gradient > threshold
        if int(wanted.sum()) > room:
            keep_best = torch.argsort(gradient, descending=True, stable=True)[:room]
            wanted = torch.zeros_like(wanted).index_fill_(0, keep_best, True) & wanted
        split, clone = wanted & (widest > large), wanted & (widest <= large)
        new = {name: tensor.detach()[clone] for name, tensor in surfels.tensors().items()}
        parents = {name: tensor.detach()[split].repeat(2, *[1] * (tensor.dim() - 1)) for name, tensor in surfels.tensors().items()}
        spread = torch.randn(len(parents["positions"]), 2, generator=generator).to(gradient.device)
        offsets = spread * parents["log_scales"].exp()
        axes = rotation_matrices(parents["quaternions"])[:, :, :2]
        parents["positions"] = parents["positions"] + (axes @ offsets[:, :, None])[:, :, 0]
        parents["log_scales"] = parents["log_scales"] - float(np.log(SPLIT_SHRINKAGE))
        optimizer.keep_and_append(~gone & ~split, {name: torch.cat([new[name], parents[name]]) for name in new})


def reset_opacity(surfels: Surfels, optimizer: ResizableAdam, opacity: float) -> None:
    """Lower every opacity to at most `opacity`, so that only the surfels that the images need regain theirs."""
    ceiling = float(np.log(opacity / (1 - opacity)))
    with torch.no_grad():
        surfels.opacity_logits.clamp_(max=ceiling)
    optimizer.reset_moments("opacity_logits")


def view_loss(rendering: Rendering, view: TrainingView, settings: SurfelSettings, with_normals: bool) -> dict[str, torch.Tensor]:
    """The weighted terms of the loss, each a mean over the view's active pixels.

    L1 and D-SSIM of the colour (Kerbl et al. 2023), L1 of the opacity against the mask, normal consistency and depth
    distortion (Huang et al. 2024, eq. 13 and 14).
    """
    terms = image_losses(rendering, view, settings.lambda_dssim, settings.lambda_mask)
    pixels = view.counted.sum()
    if with_normals:
        k = view.camera.intrinsics
        depth = rendering.depth / rendering.alpha.clamp(min=1e-3)
        surface = normals_from_depth(depth, k[0, 0], k[1, 1], k[0, 2], k[1, 2]) * rendering.alpha.detach()
        solid = view.active & (rendering.alpha.detach() > SOLID_ALPHA)
        terms["normal"] = settings.lambda_normal * normal_mismatch(rendering, surface, solid) / pixels
        if settings.lambda_distortion:
            terms["distortion"] = settings.lambda_distortion * (rendering.distortion * view.counted).sum() / pixels
    return terms


class SurfelTrainer(Trainer[Surfels, Rendering, SurfelSettings]):
    """Training of surfels, with adaptive density control."""

    title, primitives, count_name = "2DGS", "surfels", "disks"
    learning_rates = LEARNING_RATES

    def __init__(self, model: Surfels, views: ViewPyramid, initialization: Initialization, settings: SurfelSettings) -> None:
        self.renderer = make_renderer(settings.device)
        super().__init__(model, views, initialization, settings, self.renderer.device)
        self.meter = GradientMeter(len(model), self.device)
        self.generator = torch.Generator().manual_seed(settings.seed)

    def make_render_view(self, view: TrainingView) -> RenderView:
        return RenderView.from_training_view(view)

    def render(self, index: int, degree: int) -> Rendering:
        s = self.model
        sh = torch.cat([s.sh_constant, s.sh_rest], dim=1)
        parameters = (s.positions, s.log_scales, s.quaternions, s.opacity_logits, sh)
        return render(*parameters, degree, self.render_views[index], self.settings.lambda_distortion > 0, self.renderer)

    def view_loss(self, rendering: Rendering, view: TrainingView, with_normals: bool) -> dict[str, torch.Tensor]:
        return view_loss(rendering, view, self.settings, with_normals)

    def update_model(self, rendering: Rendering, index: int, share: float) -> None:
        active = float(self.views[index].active.sum())
        statistics = rendering.statistics
        self.meter.add(statistics.centre_gradient * active, statistics.visible)
        self.optimizer.set_learning_rate("positions", LEARNING_RATES["positions"] * POSITION_RATE_FALL**share)
        self.optimizer.step()
        with torch.no_grad():
            self.model.log_scales.clamp_(max=math.log(SCALE_MAX))

    def adapt_model(self) -> None:
        settings = self.settings
        first, last = settings.densify_from_share * settings.iterations, settings.densify_until_share * settings.iterations
        if first <= self.iteration <= last and self.iteration % settings.densify_every == 0:
            outside = self.initialization.free_space.contains(self.model.positions.detach().cpu().numpy().astype(float))
            densify_and_prune(
                self.model,
                self.optimizer,
                self.meter,
                threshold=settings.densify_gradient,
                large=SPLIT_SCALE,
                opacity_min=settings.opacity_min,
                excluded=torch.from_numpy(outside).to(self.device),
                count_max=settings.count_max,
                generator=self.generator,
            )
            self.meter = GradientMeter(len(self.model), self.device)
        every = math.ceil(settings.opacity_reset_share * settings.iterations)
        if self.iteration % every == 0 and self.iteration < last:
            reset_opacity(self.model, self.optimizer, INITIAL_OPACITY)

    def extra_state(self) -> dict[str, Any]:
        return {"meter": (self.meter.total, self.meter.views), "generator": self.generator.get_state()}

    def restore_extra_state(self, content: dict[str, Any]) -> None:
        self.meter.total, self.meter.views = (tensor.to(self.device) for tensor in content["meter"])
        self.generator.set_state(content["generator"])

    @classmethod
    def from_checkpoint(
        cls, content: dict[str, Any], views: ViewPyramid, initialization: Initialization, settings: SurfelSettings
    ) -> "SurfelTrainer":
        return cls(Surfels(**content["tensors"]), views, initialization, settings)
