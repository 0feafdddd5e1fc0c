"""Training of 2D Gaussian Splatting (Huang et al. 2024) on the cropped views of one object."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from zeroshop_steps.errors import StepError
from zeroshop_steps.files import written_whole
from zeroshop_steps.nvs.losses import normals_from_depth
from zeroshop_steps.nvs.ssim import dissimilarity
from zeroshop_steps.nvs.twodgs.densify import AdamWithSurgery, GradientMeter, densify_and_prune, reset_opacity
from zeroshop_steps.nvs.twodgs.render import Rendering, RenderView, render
from zeroshop_steps.nvs.twodgs.start import Start
from zeroshop_steps.nvs.twodgs.surfels import Surfels
from zeroshop_steps.nvs.views import TrainingView
from zeroshop_steps.progress import ProgressReport


@dataclass(frozen=True)
class TrainingSettings:
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


@dataclass(frozen=True)
class Views:
    """The same images at two sizes: training begins on the coarse ones."""

    coarse: list[TrainingView]
    fine: list[TrainingView]


LEARNING_RATES = {
    "positions": 6e-4, "log_scales": 5e-3, "quaternions": 1e-3, "opacity_logits": 5e-2, "sh_constant": 2.5e-3, "sh_rest": 2.5e-3 / 20,
}  # fmt: skip
POSITION_RATE_FALL = 0.01
"""The positions' learning rate at the end, as a share of that at the start; it falls exponentially (Kerbl et al. 2023)."""


def view_loss(rendering: Rendering, view: TrainingView, settings: TrainingSettings, with_normals: bool) -> dict[str, torch.Tensor]:
    """The terms of the loss, each a mean over the view's active pixels, weighted.

    Photometric L1 and D-SSIM (Kerbl et al. 2023), L1 of the opacity against the mask, normal consistency and depth
    distortion (Huang et al. 2024, eq. 13 and 14).
    """
    active = view.active
    pixels = active.sum()
    terms = {
        "l1": (1 - settings.lambda_dssim) * ((rendering.color - view.color).abs().sum(0) * active).sum() / (3 * pixels),
        "dssim": settings.lambda_dssim * dissimilarity(rendering.color, view.color, active.float()) / (3 * pixels),
        "mask": settings.lambda_mask * ((rendering.alpha - view.mask).abs() * active).sum() / pixels,
    }
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


def depth_loss(rendering: Rendering, pixels: torch.Tensor, depths: torch.Tensor, active_pixels: torch.Tensor) -> torch.Tensor:
    """Absolute differences of the expected depth from confirmed ones: (K,) flat pixel indices and (K,) depths.

    Their sum is divided by the number of active pixels, so that a single confirmed depth weighs the same however many there
    are. Confirmed depths are more exact than what colour alone finds where there is little print: they weigh much more than it.
    """
    if len(pixels) == 0:
        return rendering.depth.sum() * 0.0
    depth = rendering.depth.reshape(-1)[pixels] / rendering.alpha.reshape(-1)[pixels].clamp(min=1e-2)
    return (depth - depths).abs().sum() / active_pixels


def _anchors(view: TrainingView, start: Start) -> tuple[torch.Tensor, torch.Tensor]:
    k, rays = view.camera.intrinsics, start.rays[view.camera.name]
    x = np.floor(rays[:, 0] * k[0, 0] + k[0, 2]).astype(int).clip(0, view.camera.width_px - 1)
    y = np.floor(rays[:, 1] * k[1, 1] + k[1, 2]).astype(int).clip(0, view.camera.height_px - 1)
    return torch.from_numpy(y * view.camera.width_px + x), torch.from_numpy(start.depths[view.camera.name])


class Trainer:
    """One training run that can be stopped, kept and resumed."""

    def __init__(self, surfels: Surfels, views: Views, start: Start, settings: TrainingSettings) -> None:
        self.pyramid, self.start, self.settings = views, start, settings
        self.surfels = surfels
        self.optimizer = AdamWithSurgery(surfels, LEARNING_RATES)
        self.meter = GradientMeter(len(surfels))
        self.iteration = 0
        self.order = np.random.default_rng(settings.seed)
        self.generator = torch.Generator().manual_seed(settings.seed)
        self.queue: list[int] = []
        self._take(views.coarse)
        self.history: list[dict[str, float]] = []

    def _take(self, views: list[TrainingView]) -> None:
        """Train on these views from now on."""
        self.views = views
        self.render_views = [RenderView.around_object(view) for view in views]
        self.anchors = [_anchors(view, self.start) for view in views]

    def render(self, index: int, degree: int) -> Rendering:
        """Draw training view `index`."""
        s = self.surfels
        sh = torch.cat([s.sh_constant, s.sh_rest], dim=1)
        return render(s.positions, s.log_scales, s.quaternions, s.opacity_logits, sh, degree, self.render_views[index])

    def run(self, until: int) -> None:
        """Train up to iteration `until`, showing loss and count."""
        with ProgressReport("2DGS", self.settings.iterations) as report:
            report.done = self.iteration
            while self.iteration < until:
                loss = self.step()
                if self.iteration % 20 == 0 or self.iteration == until:
                    report.advance(self.iteration - report.done, f"loss {loss:.4f}, {len(self.surfels)} disks")

    def step(self) -> float:
        """One view: render, differentiate, update, and densify when it is time. Returns the loss."""
        settings, share = self.settings, self.iteration / self.settings.iterations
        if share >= settings.coarse_share and self.views is not self.pyramid.fine:
            self._take(self.pyramid.fine)
        if not self.queue:
            self.queue = self.order.permutation(len(self.views)).tolist()
        index = self.queue.pop()
        degree = min(settings.sh_degree, int(share * 2 * (settings.sh_degree + 1)))
        self.optimizer.set_learning_rate("positions", LEARNING_RATES["positions"] * POSITION_RATE_FALL**share)
        rendering = self.render(index, degree)
        terms = view_loss(rendering, self.views[index], settings, share >= settings.normal_from_share)
        terms["depth"] = settings.lambda_depth * depth_loss(rendering, *self.anchors[index], self.views[index].active.sum())
        loss = sum(terms.values())
        loss.backward()
        active = float(self.views[index].active.sum())
        self.meter.add(rendering.footprint.centre_gradient * active, rendering.footprint.visible)
        self.optimizer.step()
        with torch.no_grad():
            self.surfels.log_scales.clamp_(max=math.log(SCALE_MAX))
        self.iteration += 1
        self._control_density()
        if self.iteration % 50 == 0:
            row = {"iteration": self.iteration, "count": len(self.surfels), "loss": float(loss.detach())}
            self.history.append(row | {name: float(value.detach()) for name, value in terms.items()})
        return float(loss.detach())

    def _control_density(self) -> None:
        settings = self.settings
        first, last = settings.densify_from_share * settings.iterations, settings.densify_until_share * settings.iterations
        if first <= self.iteration <= last and self.iteration % settings.densify_every == 0:
            outside = self.start.free_space.holds(self.surfels.positions.detach().numpy().astype(float))
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

    def psnr_db(self, index: int) -> float:
        """Peak signal-to-noise ratio of training view `index` over its active pixels."""
        with torch.no_grad():
            color = self.render(index, self.settings.sh_degree).color
        view = self.views[index]
        error = ((color - view.color) ** 2).mean(0)[view.active].mean()
        return float(-10.0 * torch.log10(error.clamp(min=1e-10)))

    def save(self, path: Path, identity: dict[str, Any]) -> None:
        """Keep everything that `resume` needs to go on to the same bytes; `identity` says what the run was made from."""
        content = {
            "identity": identity,
            "iteration": self.iteration,
            "settings": vars(self.settings),
            "tensors": {name: tensor.detach() for name, tensor in self.surfels.tensors().items()},
            "adam": self.optimizer.adam.state_dict(),
            "meter": (torch.from_numpy(self.meter.total), torch.from_numpy(self.meter.views)),
            "order": self.order.bit_generator.state,
            "generator": self.generator.get_state(),
            "queue": self.queue,
            "history": self.history,
        }
        with written_whole(path) as temporary:
            torch.save(content, temporary)

    @staticmethod
    def resume(path: Path, views: Views, start: Start, settings: TrainingSettings, identity: dict[str, Any]) -> "Trainer | None":
        """The run kept in `path`, or None when it belongs to other inputs or settings."""
        try:
            content = torch.load(path, weights_only=True)
        except Exception as error:
            raise StepError(f"checkpoint {path} is damaged ({type(error).__name__}); delete it and train again") from None
        if content["settings"] != vars(settings) or content["identity"] != identity:
            return None
        trainer = Trainer(Surfels(**content["tensors"]), views, start, settings)
        trainer.optimizer.adam.load_state_dict(content["adam"])
        trainer.meter.total, trainer.meter.views = (tensor.numpy() for tensor in content["meter"])
        trainer.iteration, trainer.queue, trainer.history = content["iteration"], content["queue"], content["history"]
        trainer.order.bit_generator.state = content["order"]
        trainer.generator.set_state(content["generator"])
        return trainer
