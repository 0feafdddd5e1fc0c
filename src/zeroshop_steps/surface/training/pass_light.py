"""The light of later passes: an object that is turned over under fixed lamps is lit from its other side.

What a matt surface sends back depends on its normal, smoothly (Ramamoorthi & Hanrahan 2001): nine functions of the normal explain
nearly all of it. So the light of a later pass is that of the first times a factor, whose logarithm is a sum of these functions, one
for each colour channel. It is fitted beside the training, to photos and renderings, and taken out of the photos before they are
compared. The model keeps the light of the first pass.
"""

from dataclasses import replace

import numpy as np
import torch

from zeroshop_steps.geometry.cameras.object_crops import STRIDE_PX
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.training.losses import SOLID_ALPHA, RenderedImages

MEMORY = 0.97
"""Share of what was learned that stays when another view comes: the model changes while it is trained."""
LOG_FACTOR_MAX = 1.1
"""A factor of three; more is no other light, but another colour."""
DARKEST = 0.04
"""Brightness, of 1, below which noise dominates the ratio of photo and rendering."""
OUTLIER = 0.15
"""Difference of logarithms at which a pixel counts half: highlights, cast shadows, and where the model is not right yet."""
CAUTION = 1e-3
"""Weight of the wish for the same light, as a share of a view's pixels: for normals that no view shows."""


def light_basis(normals: torch.Tensor) -> torch.Tensor:
    """(9, K) polynomials up to degree 2 of (3, K) unit normals: they span the spherical harmonics of these degrees."""
    x, y, z = normals
    return torch.stack([torch.ones_like(x), x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1])


class PassLight:
    """The light of every later pass beside that of the first.

    Attributes:
        coefficients: (P, 9, 3) of passes 2 to P + 1 and the three colour channels.
    """

    def __init__(self, later_passes: int, device: torch.device | str = "cpu") -> None:
        self.coefficients = torch.zeros(later_passes, 9, 3, device=device)
        # Least squares, a channel each: what the views have said so far, the latest most.
        self.products = torch.zeros(later_passes, 3, 9, 9, device=device)
        self.targets = torch.zeros(later_passes, 3, 9, device=device)

    @classmethod
    def for_views(cls, views: list[TrainingView]) -> "PassLight":
        """The same light in all passes, to begin with."""
        return cls(max((view.pass_number for view in views), default=1) - 1, views[0].color.device if views else "cpu")

    def learn(self, rendering: RenderedImages, view: TrainingView) -> None:
        """Fit the light better to one more view; the first pass says nothing of it."""
        if view.pass_number == 1:
            return
        which = view.pass_number - 2
        solid, basis = _find_basis(rendering, view, STRIDE_PX)
        alpha, drawn, shown, counted = (
            one[..., ::STRIDE_PX, ::STRIDE_PX].flatten(-2)
            for one in (rendering.alpha.detach(), rendering.color.detach(), view.color, view.counted)
        )
        drawn = drawn / alpha.clamp(min=SOLID_ALPHA)
        ratio = torch.log(shown.clamp(min=DARKEST) / drawn.clamp(min=DARKEST))
        usable = solid & (shown > DARKEST) & (drawn > DARKEST) & (ratio.abs() < LOG_FACTOR_MAX)
        misfit = (ratio - self.coefficients[which].T @ basis) / OUTLIER
        weights = counted * usable / (1.0 + misfit * misfit) / solid.sum().clamp(min=1)
        weighted = weights[:, None] * basis
        self.products[which] = MEMORY * self.products[which] + weighted @ basis.T
        self.targets[which] = MEMORY * self.targets[which] + (weighted @ ratio[..., None])[..., 0]
        ridged = self.products[which] + CAUTION * torch.eye(9, device=basis.device)
        self.coefficients[which] = torch.linalg.solve(ridged, self.targets[which]).T

    def relight(self, rendering: RenderedImages, view: TrainingView) -> TrainingView:
        """The view, its photo as if it had been taken in the light of the first pass."""
        if view.pass_number == 1:
            return view
        solid, basis = _find_basis(rendering, view)
        factors = (self.coefficients[view.pass_number - 2].T @ basis).clamp(-LOG_FACTOR_MAX, LOG_FACTOR_MAX)
        factors = (-factors * solid).exp()
        return replace(view, color=view.color * factors.reshape(view.color.shape))

    def state(self) -> dict[str, torch.Tensor]:
        """What a checkpoint keeps; `restore` takes it back."""
        return {"coefficients": self.coefficients, "products": self.products, "targets": self.targets}

    def restore(self, content: dict[str, torch.Tensor]) -> None:
        """Take back what `state` gave."""
        device = self.coefficients.device
        kept = (content[key].clone().to(device) for key in ("coefficients", "products", "targets"))
        self.coefficients, self.products, self.targets = kept


def _find_basis(rendering: RenderedImages, view: TrainingView, stride_px: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Of every so many pixels of every so many rows: (K,) bool whether its normal is known, and the (9, K) basis there."""
    part = (..., slice(None, None, stride_px), slice(None, None, stride_px))
    solid = (view.active[part] & (rendering.alpha.detach()[part] > SOLID_ALPHA)).flatten()
    world_from_camera = torch.from_numpy(view.camera.camera_from_world[:3, :3].T.astype(np.float32)).to(solid.device)
    normals = world_from_camera @ rendering.normal.detach()[part].flatten(1)
    return solid, light_basis(normals / (normals * normals).sum(0).clamp(min=1e-12).sqrt())
