"""The training loop that the optimizers share: one view an iteration, coarse images first, checkpoints, the curve of the loss."""

import csv
import dataclasses
from abc import ABC, abstractmethod
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from zeroshop_steps.geometry.crops import ObjectSphere, fit_object_sphere
from zeroshop_steps.runtime.cache import content_digest
from zeroshop_steps.runtime.code_version import code_version
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write, write_json
from zeroshop_steps.runtime.progress import ProgressReport
from zeroshop_steps.surface.initialization import Initialization
from zeroshop_steps.surface.optimizer import ResizableAdam
from zeroshop_steps.surface.seeds import Seeds, read_seeds
from zeroshop_steps.surface.ssim import dssim
from zeroshop_steps.surface.training_views import CameraSet, TrainingView, make_seed_views, make_training_views, read_camera_set

CHECKPOINT = "checkpoint.pt"
"""The run as far as it has come, beside what it is to write."""


@dataclass(frozen=True)
class ViewPyramid:
    """The same images at two sizes: training begins on the coarse ones."""

    coarse: list[TrainingView]
    fine: list[TrainingView]


class TrainingSettings(Protocol):
    """What every optimizer's settings hold; shares of the run are fractions of `iterations`."""

    iterations: int
    sh_degree: int
    seed: int
    coarse_share: float


class RenderedImages(Protocol):
    """The part of a rendering that every optimizer has: sums over the blending weights, not divided by the opacity."""

    color: torch.Tensor
    depth: torch.Tensor
    alpha: torch.Tensor


def image_losses(rendering: RenderedImages, view: TrainingView, lambda_dssim: float, lambda_mask: float) -> dict[str, torch.Tensor]:
    """Photometric L1 and D-SSIM (Kerbl et al. 2023) and L1 of the opacity against the mask: weighted means over the active pixels."""
    active = view.active
    pixels = active.sum()
    return {
        "l1": (1 - lambda_dssim) * ((rendering.color - view.color).abs().sum(0) * active).sum() / (3 * pixels),
        "dssim": lambda_dssim * dssim(rendering.color, view.color, active.float()) / (3 * pixels),
        "mask": lambda_mask * ((rendering.alpha - view.mask).abs() * active).sum() / pixels,
    }


def depth_loss(rendering: RenderedImages, pixels: torch.Tensor, depths: torch.Tensor, active_pixels: torch.Tensor) -> torch.Tensor:
    """Absolute differences of the expected depth from confirmed ones: (K,) flat pixel indices and (K,) depths.

    Their sum is divided by the number of active pixels, so that a single confirmed depth weighs the same however many there
    are. Confirmed depths are more exact than what colour alone finds where there is little print: they weigh much more than it.
    """
    if len(pixels) == 0:
        return rendering.depth.sum() * 0.0
    depth = rendering.depth.reshape(-1)[pixels] / rendering.alpha.reshape(-1)[pixels].clamp(min=1e-2)
    return (depth - depths).abs().sum() / active_pixels


def depth_targets(view: TrainingView, initialization: Initialization) -> tuple[torch.Tensor, torch.Tensor]:
    """(K,) flat pixel indices of a view and (K,) the depths that were confirmed there before training."""
    k, rays = view.camera.intrinsics, initialization.confirmed_rays[view.camera.name]
    x = np.floor(rays[:, 0] * k[0, 0] + k[0, 2]).astype(int).clip(0, view.camera.width_px - 1)
    y = np.floor(rays[:, 1] * k[1, 1] + k[1, 2]).astype(int).clip(0, view.camera.height_px - 1)
    return torch.from_numpy(y * view.camera.width_px + x), torch.from_numpy(initialization.confirmed_depths[view.camera.name])


class Trainer(ABC):
    """One training run that can be stopped, kept and resumed; what is trained, drawn and lost is the optimizer's own.

    Class attributes: title, shown while it trains, and noun, what it counts.
    """

    title: str
    noun: str

    def __init__(
        self, model: Any, optimizer: ResizableAdam, views: ViewPyramid, initialization: Initialization, settings: TrainingSettings
    ) -> None:
        self.model, self.optimizer = model, optimizer
        self.pyramid, self.initialization, self.settings = views, initialization, settings
        self.iteration = 0
        self.order = np.random.default_rng(settings.seed)
        self.queue: list[int] = []
        self.set_views(views.coarse)
        self.history: list[dict[str, float]] = []

    @abstractmethod
    def make_render_views(self, views: list[TrainingView]) -> list[Any]:
        """What the renderer needs to know of each view."""

    @abstractmethod
    def render(self, index: int, degree: int) -> RenderedImages:
        """Draw training view `index`."""

    @abstractmethod
    def losses(self, rendering: Any, index: int, share: float) -> dict[str, torch.Tensor]:
        """The weighted terms of the loss at this share of the run."""

    @abstractmethod
    def update_model(self, rendering: Any, index: int, share: float) -> None:
        """Update the model from its gradients."""

    @abstractmethod
    def adapt_model(self) -> None:
        """Add and remove parts of the model when it is time."""

    def extra_state(self) -> dict[str, Any]:
        """What a checkpoint holds beyond the shared part; `restore` takes it back."""
        return {}

    @abstractmethod
    def restore_extra_state(self, content: dict[str, Any]) -> None:
        """Take back what `state` gave."""

    @classmethod
    @abstractmethod
    def from_checkpoint(cls, content: dict[str, Any], views: ViewPyramid, initialization: Initialization, settings: Any) -> "Trainer":
        """A trainer of the model in a checkpoint."""

    def set_views(self, views: list[TrainingView]) -> None:
        """Train on these views from now on."""
        self.views = views
        self.render_views = self.make_render_views(views)
        self.depth_targets = [depth_targets(view, self.initialization) for view in views]

    def run(self, until: int, report: ProgressReport | None = None) -> None:
        """Train up to iteration `until`, showing loss and count in `report`."""
        while self.iteration < until:
            loss = self.step()
            if report and (self.iteration % 20 == 0 or self.iteration == until):
                report.advance(self.iteration - report.done, f"loss {loss:.4f}, {len(self.model)} {self.noun}")

    def step(self) -> float:
        """One view: render, differentiate, update, and adapt the model when it is time. Returns the loss."""
        settings, share = self.settings, self.iteration / self.settings.iterations
        if share >= settings.coarse_share and self.views is not self.pyramid.fine:
            self.set_views(self.pyramid.fine)
        if not self.queue:
            self.queue = self.order.permutation(len(self.views)).tolist()
        index = self.queue.pop()
        rendering = self.render(index, min(settings.sh_degree, int(share * 2 * (settings.sh_degree + 1))))
        terms = self.losses(rendering, index, share)
        loss = sum(terms.values())
        loss.backward()
        self.update_model(rendering, index, share)
        self.iteration += 1
        self.adapt_model()
        if self.iteration % 50 == 0:
            row = {"iteration": self.iteration, "count": len(self.model), "loss": float(loss.detach())}
            self.history.append(row | {name: float(value.detach()) for name, value in terms.items()})
        return float(loss.detach())

    def psnr_db(self, index: int) -> float:
        """Peak signal-to-noise ratio of training view `index` over its active pixels."""
        with torch.no_grad():
            color = self.render(index, self.settings.sh_degree).color
        view = self.views[index]
        error = ((color - view.color) ** 2).mean(0)[view.active].mean()
        return float(-10.0 * torch.log10(error.clamp(min=1e-10)))

    def run_with_checkpoints(self, every: int, path: Path, identity: dict[str, Any], cameras: Path) -> None:
        """Train to the end, keeping a checkpoint after every `every` iterations.

        Raises StepError, naming the folder of the cameras, when a parameter is no longer finite.
        """
        with ProgressReport(self.title, self.settings.iterations, done=self.iteration) as report:
            while self.iteration < self.settings.iterations:
                self.run(min(self.iteration + every, self.settings.iterations), report)
                if self.iteration < self.settings.iterations:
                    self.save(path, identity)
        if not all(torch.isfinite(tensor).all() for tensor in self.model.tensors().values()):
            raise StepError(f"training on {cameras} diverged (parameters that are not finite); lower --sh-degree or check the cameras")

    def save(self, path: Path, identity: dict[str, Any]) -> None:
        """Keep everything that `resume` needs to go on to the same bytes; `identity` says what the run was made from."""
        content = {
            "identity": identity,
            "iteration": self.iteration,
            "settings": vars(self.settings),
            "tensors": {name: tensor.detach() for name, tensor in self.model.tensors().items()},
            "adam": self.optimizer.adam.state_dict(),
            "order": self.order.bit_generator.state,
            "queue": self.queue,
            "history": self.history,
        }
        with atomic_write(path) as temporary:
            try:
                torch.save(content | self.extra_state(), temporary)
            except RuntimeError as error:  # what PyTorch makes of a full disk
                raise OSError(str(error).splitlines()[0]) from error

    @classmethod
    def resume(
        cls, path: Path, views: ViewPyramid, initialization: Initialization, settings: TrainingSettings, identity: dict[str, Any]
    ) -> "Trainer | None":
        """The run kept in `path`, or None when it belongs to other inputs or settings."""
        try:
            content = torch.load(path, weights_only=True)
        except Exception as error:
            raise StepError(f"checkpoint {path} is damaged ({type(error).__name__}); delete it and train again") from None
        if content["settings"] != vars(settings) or content["identity"] != identity:
            return None
        trainer = cls.from_checkpoint(content, views, initialization, settings)
        trainer.optimizer.adam.load_state_dict(content["adam"])
        trainer.iteration, trainer.queue, trainer.history = content["iteration"], content["queue"], content["history"]
        trainer.order.bit_generator.state = content["order"]
        trainer.restore_extra_state(content)
        return trainer


@dataclass(frozen=True)
class TrainingInputs:
    """What an optimizer trains on.

    Attributes:
        seed_views: the views that stereo used, whose names and sizes its depth maps have.
        identity: says which images, cameras and seeds these are, for checkpoints.
    """

    camera_set: CameraSet
    sphere: ObjectSphere
    views: ViewPyramid
    seed_views: list[TrainingView]
    seeds: Seeds
    identity: dict[str, Any]

    @staticmethod
    def read(args: Namespace, step: str) -> "TrainingInputs":
        """From the options --cameras, --stereo and --image-width-px, for a step of this package, e.g. "surface.twodgs"."""
        camera_set = read_camera_set(args.cameras)
        sphere = fit_object_sphere(camera_set.model.cameras, camera_set.masks)
        views = ViewPyramid(
            make_training_views(camera_set, sphere, args.image_width_px // 2, border_px=6),
            make_training_views(camera_set, sphere, args.image_width_px, border_px=8),
        )
        stereo_views = make_seed_views(camera_set, sphere)
        seeds = read_seeds(args.stereo, sphere, [view.camera for view in stereo_views])
        # A checkpoint belongs to its images, cameras, seeds and code as much as to its settings.
        poses = [view.camera.camera_from_world.ravel().tolist() for view in views.fine]
        identity = {
            "image_width_px": args.image_width_px,
            "cameras": poses,
            "stereo": content_digest(args.stereo),
            "code": code_version(step),
        }
        return TrainingInputs(camera_set, sphere, views, stereo_views, seeds, identity)


def write_curve(path: Path, history: list[dict[str, float]]) -> None:
    """Write the loss by term as CSV, one row an entry; a term that an entry lacks stays empty."""
    with atomic_write(path) as temporary, open(temporary, "w", newline="") as file:
        names = list(dict.fromkeys(name for row in history for name in row))
        writer = csv.DictWriter(file, names, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: f"{value:.6g}" for key, value in row.items()} for row in history)


def write_record(args: Namespace, trainer: Trainer, method: str, threads: int, resumed_from: int, seconds: tuple[float, float]) -> None:
    """Write training.csv and training.json into --out; seconds: of wall time and of CPU time. The checkpoint has then served its turn."""
    write_curve(args.out / "training.csv", trainer.history)
    write_json(
        args.out / "training.json",
        {
            "method": method,
            "seconds": round(seconds[0], 2),
            "cpu_seconds": round(seconds[1], 2),
            "resumed_from_iteration": resumed_from,
            "threads": threads,
            "image_width_px": args.image_width_px,
            "settings": dataclasses.asdict(trainer.settings),
            trainer.noun: len(trainer.model),
            "psnr_training_db": round(float(np.mean([trainer.psnr_db(index) for index in range(len(trainer.pyramid.fine))])), 3),
        },
    )
    (args.out / CHECKPOINT).unlink(missing_ok=True)
