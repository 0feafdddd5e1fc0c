"""The training loop that the optimizers share: one view an iteration, coarse images first, checkpoints, the curve of the loss."""

import io
import os
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import numpy as np
import torch

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write
from zeroshop_steps.runtime.progress import ProgressReport
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.training.initialization import Initialization
from zeroshop_steps.surface.training.losses import RenderedImages, depth_loss
from zeroshop_steps.surface.training.optimizer import ResizableAdam, TrainableModel
from zeroshop_steps.surface.training.pass_light import PassLight
from zeroshop_steps.surface.training.training_options import TrainingSettings

ModelT = TypeVar("ModelT", bound=TrainableModel)
RenderingT = TypeVar("RenderingT", bound=RenderedImages)
SettingsT = TypeVar("SettingsT", bound=TrainingSettings)

RECORD_EVERY = 50
"""Iterations between rows of training.csv, and between updates of the progress display."""


@dataclass(frozen=True)
class ViewPyramid:
    """The same images at two sizes: training begins on the coarse ones."""

    coarse: list[TrainingView]
    fine: list[TrainingView]

    def to(self, device: torch.device) -> "ViewPyramid":
        """The views with their images on a device; these, if they are there."""
        if all(view.color.device == device for view in (*self.coarse, *self.fine)):
            return self
        return ViewPyramid([view.to(device) for view in self.coarse], [view.to(device) for view in self.fine])


def find_depth_targets(view: TrainingView, initialization: Initialization) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(K,) flat pixel indices of a view, the depths that were known there before training, and their weights, on the view's device."""
    device = view.color.device
    k, rays = view.camera.intrinsics, initialization.confirmed_rays[view.camera.name]
    x = np.floor(rays[:, 0] * k[0, 0] + k[0, 2]).astype(int).clip(0, view.camera.width_px - 1)
    y = np.floor(rays[:, 1] * k[1, 1] + k[1, 2]).astype(int).clip(0, view.camera.height_px - 1)
    depths, weights = (
        torch.from_numpy(values[view.camera.name]) for values in (initialization.confirmed_depths, initialization.confirmed_weights)
    )
    return torch.from_numpy(y * view.camera.width_px + x).to(device), depths.to(device), weights.to(device)


class Trainer(ABC, Generic[ModelT, RenderingT, SettingsT]):
    """One training run that can be stopped, saved and resumed. Model, renderer and losses are each optimizer's own.

    Class attributes:
        title: the optimizer's name in the progress display.
        primitives: what the model consists of, in messages.
        count_name: the entry of training.json that holds their number.
        learning_rates, betas: those of Adam, the rates by the name of the tensor.
    """

    title: str
    primitives: str
    count_name: str
    learning_rates: dict[str, float]
    betas: tuple[float, float] = (0.9, 0.999)

    def __init__(
        self, model: ModelT, views: ViewPyramid, initialization: Initialization, settings: SettingsT, device: torch.device | None = None
    ) -> None:
        if device is not None and device.type == "cuda":
            # As on the CPU, the same inputs give the same bytes: sums in one order. What PyTorch cannot do so, it says.
            os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
            torch.use_deterministic_algorithms(True, warn_only=True)
        self.device = device or torch.device("cpu")
        for name, tensor in model.tensors().items():
            setattr(model, name, tensor.to(self.device))
        views = views.to(self.device)
        self.model, self.optimizer = model, ResizableAdam(model, self.learning_rates, self.betas)
        self.pyramid, self.initialization, self.settings = views, initialization, settings
        self.pass_light = PassLight.for_views(views.fine)
        self.iteration = 0
        self.order = np.random.default_rng(settings.seed)
        self.queue: list[int] = []
        self.set_views(views.coarse)
        self.history: list[dict[str, float]] = []

    @abstractmethod
    def make_render_view(self, view: TrainingView) -> Any:
        """What the renderer needs to know of a view."""

    @abstractmethod
    def render(self, index: int, degree: int) -> RenderingT:
        """Draw training view `index` with spherical harmonics up to `degree`."""

    @abstractmethod
    def view_loss(self, rendering: RenderingT, view: TrainingView, with_normals: bool) -> dict[str, torch.Tensor]:
        """The weighted terms of the loss by name, except that of the confirmed depths."""

    @abstractmethod
    def update_model(self, rendering: RenderingT, index: int, share: float) -> None:
        """Take one step of the optimizer, once the model has gradients; share: how much of the run is done."""

    @abstractmethod
    def adapt_model(self) -> None:
        """Add and remove parts of the model when it is time."""

    @abstractmethod
    def extra_state(self) -> dict[str, Any]:
        """What a checkpoint of this optimizer holds beyond the shared part; `restore_extra_state` takes it back."""

    @abstractmethod
    def restore_extra_state(self, content: dict[str, Any]) -> None:
        """Take back what `extra_state` gave."""

    @classmethod
    @abstractmethod
    def from_checkpoint(cls, content: dict[str, Any], views: ViewPyramid, initialization: Initialization, settings: SettingsT) -> Self:
        """A trainer of the model in a checkpoint."""

    def set_views(self, views: list[TrainingView]) -> None:
        """Train on these views from now on."""
        self.views = views
        self.render_views = [self.make_render_view(view) for view in views]
        self.depth_targets = [find_depth_targets(view, self.initialization) for view in views]

    def losses(self, rendering: RenderingT, index: int, share: float) -> dict[str, torch.Tensor]:
        """The weighted terms of the loss by name; share: how much of the run is done."""
        settings, view = self.settings, self.pass_light.relight(rendering, self.views[index])
        terms = self.view_loss(rendering, view, share >= settings.normal_from_share)
        pixels, depths, weights = self.depth_targets[index]
        # Stereo's depths are dense, and each weighs the same. Sparse points are few: their mean counts, as in Sun et al. 2025.
        total = view.active.sum() if settings.initialization == "stereo" else torch.tensor(len(pixels), device=pixels.device)
        terms["depth"] = settings.lambda_depth * depth_loss(rendering, pixels, depths, weights, total)
        return terms

    def run(self, until: int, report: ProgressReport | None = None) -> None:
        """Train up to iteration `until`, showing the loss and the number of primitives in `report`."""
        while self.iteration < until:
            loss = self.step()
            if report and (self.iteration % RECORD_EVERY == 0 or self.iteration == until):
                report.advance(self.iteration - report.done, f"loss {loss:.4f}, {len(self.model)} {self.primitives}")

    def step(self) -> float:
        """One view: render, differentiate, update, and adapt the model when it is time. Returns the loss."""
        settings, share = self.settings, self.iteration / self.settings.iterations
        if share >= settings.coarse_share and self.views is not self.pyramid.fine:
            self.set_views(self.pyramid.fine)
        if not self.queue:
            self.queue = self.order.permutation(len(self.views)).tolist()
        index = self.queue.pop()
        rendering = self.render(index, min(settings.sh_degree, int(share * 2 * (settings.sh_degree + 1))))
        self.pass_light.learn(rendering, self.views[index])
        terms = self.losses(rendering, index, share)
        loss = torch.as_tensor(sum(terms.values()))
        loss.backward()
        self.update_model(rendering, index, share)
        self.iteration += 1
        self.adapt_model()
        if self.iteration % RECORD_EVERY == 0:
            row = {"iteration": self.iteration, "count": len(self.model), "loss": float(loss.detach())}
            self.history.append(row | {name: float(value.detach()) for name, value in terms.items()})
        return float(loss.detach())

    def psnr_db(self, index: int) -> float:
        """Peak signal-to-noise ratio of training view `index` over its active pixels, in the light of the first pass."""
        with torch.no_grad():
            rendering = self.render(index, self.settings.sh_degree)
        view = self.pass_light.relight(rendering, self.views[index])
        error = ((rendering.color - view.color) ** 2).mean(0)[view.active].mean()
        return float(-10.0 * torch.log10(error.clamp(min=1e-10)))

    def run_with_checkpoints(self, every: int, path: Path, identity: dict[str, Any], cameras: Path) -> None:
        """Train to the end, saving a checkpoint after every `every` iterations.

        Raises:
            StepError: a parameter is no longer finite; the message names the folder of the cameras.
        """
        with ProgressReport(self.title, self.settings.iterations, done=self.iteration) as report:
            while self.iteration < self.settings.iterations:
                self.run(min(self.iteration + every, self.settings.iterations), report)
                if self.iteration < self.settings.iterations:
                    self.save(path, identity)
        if not all(torch.isfinite(tensor).all() for tensor in self.model.tensors().values()):
            raise StepError(f"training on {cameras} diverged (parameters that are not finite); lower --sh-degree or check the cameras")

    def save(self, path: Path, identity: dict[str, Any]) -> None:
        """Save everything that `resume` needs to end with the same bytes; `identity` says what the run was made from."""
        content = {
            "identity": identity,
            "iteration": self.iteration,
            "settings": vars(self.settings),
            "tensors": {name: tensor.detach() for name, tensor in self.model.tensors().items()},
            "adam": self.optimizer.adam.state_dict(),
            "order": self.order.bit_generator.state,
            "queue": self.queue,
            "history": self.history,
            "pass_light": self.pass_light.state(),
        }
        memory = io.BytesIO()  # PyTorch's own files tell of a full disk in riddles
        torch.save(content | self.extra_state(), memory)
        with atomic_write(path) as temporary:
            temporary.write_bytes(memory.getbuffer())

    @classmethod
    def resume(
        cls, path: Path, views: ViewPyramid, initialization: Initialization, settings: SettingsT, identity: dict[str, Any]
    ) -> Self | None:
        """The run saved in `path`, or None when it belongs to other inputs or settings."""
        try:
            content = torch.load(path, weights_only=True, map_location="cpu")
        except Exception as error:
            raise StepError(f"checkpoint {path} is damaged ({type(error).__name__}); delete it and train again") from None
        if content["settings"] != vars(settings) or content["identity"] != identity:
            return None
        trainer = cls.from_checkpoint(content, views, initialization, settings)
        trainer.optimizer.adam.load_state_dict(content["adam"])
        trainer.iteration, trainer.queue, trainer.history = content["iteration"], content["queue"], content["history"]
        trainer.order.bit_generator.state = content["order"]
        trainer.pass_light.restore(content["pass_light"])
        trainer.restore_extra_state(content)
        return trainer
