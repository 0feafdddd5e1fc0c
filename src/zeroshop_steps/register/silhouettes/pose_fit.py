"""How well cameras that outlines placed fit them once adjusted, and which views contradict the others."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.register.silhouettes.bundle_adjustment import SilhouetteAdjustment
from zeroshop_steps.register.silhouettes.state import NO_TRACKS

FINE_MISS_PX, WRONG_MISS_PX = 0.3, 0.6
"""After adjusting, in the mean of all rays, and of those of any view, per 1000 px of the image. Right cameras with exact masks: 0.05. Of
submodels that are merged, the mean of a wrong way is beyond the second."""
STANDS_OUT, STANDS_OUT_PX = 2.0, 0.15
"""A view that misses by so many times what the median view does, and by more than this, stands a few degrees off, and is left out."""


@dataclass(frozen=True)
class SilhouetteFit:
    """Cameras adjusted by their outlines, and by how much rays then miss, px per 1000 px of the image.

    Attributes:
        cameras: N of them.
        numbers: (N,) which of the views they are.
        miss_px: in the mean.
        by_view_px: (N,) in the mean of each view's rays.
        contradictions_px: (N,) the same with the rays of others that miss its mask.
    """

    cameras: list[Camera]
    numbers: np.ndarray
    miss_px: float
    by_view_px: np.ndarray
    contradictions_px: np.ndarray

    @property
    def worst_px(self) -> float:
        """The mean of the view whose rays miss most."""
        return float(self.by_view_px.max())

    @property
    def is_fine(self) -> bool:
        """Whether the outlines fit together."""
        return self.miss_px <= FINE_MISS_PX and self.worst_px <= WRONG_MISS_PX

    def find_fitting(self) -> np.ndarray:
        """(N,) bool: the views that do not stand out."""
        fitting: np.ndarray = self.by_view_px <= max(STANDS_OUT * float(np.median(self.by_view_px)), STANDS_OUT_PX)
        return fitting

    def take(self, kept: np.ndarray, masks: dict[str, np.ndarray]) -> "SilhouetteFit":
        """These (K,) cameras alone, adjusted anew; masks as in `adjust`."""
        return adjust([self.cameras[number] for number in kept], self.numbers[kept], masks)

    def leave_out_worst(self, masks: dict[str, np.ndarray]) -> tuple["SilhouetteFit", str, float]:
        """The others without the view that contradicts them most, adjusted anew; its name, and by how much it does."""
        worst = int(self.contradictions_px.argmax())
        others = np.delete(np.arange(len(self.cameras)), worst)
        return self.take(others, masks), self.cameras[worst].name, float(self.contradictions_px[worst])


def adjust(cameras: list[Camera], numbers: np.ndarray, masks: dict[str, np.ndarray]) -> SilhouetteFit:
    """Cameras of views with (N,) numbers, adjusted by the outlines of their masks, {image name: (height, width) bool}."""
    adjustment = SilhouetteAdjustment(cameras, masks, NO_TRACKS)
    adjustment.adjust()
    misses_px = adjustment.measure_misses_px()
    by_view_px = np.array([misses_px[adjustment.rays.view == number].mean() for number in range(len(cameras))])
    contradictions_px = adjustment.measure_contradictions_px(misses_px)
    return SilhouetteFit(adjustment.adjusted_cameras(), numbers, float(misses_px.mean()), by_view_px, contradictions_px)


def describe_fit(best_px: float, adjusted_px: list[tuple[float, float]]) -> str:
    """By how much outlines miss each other: as cameras were found, or, where these were likely, on average and at worst once adjusted."""
    if not adjusted_px:
        return f"{best_px:.1f} px per 1000 px at best"
    mean_px, worst_px = min(adjusted_px)
    return f"of 1000 px, they miss by {mean_px:.1f} px in the mean, and by {worst_px:.1f} px in the worst photo"
