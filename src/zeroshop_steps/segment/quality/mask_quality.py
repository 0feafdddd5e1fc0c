"""Rate masks without a ground truth: by agreement with the other views' masks, completeness and size."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.images import measure_border_share
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.runtime.errors import StepError

TOLERANCE = 0.02
"""Width of the rim that may differ, as a share of the square root of the mask's area: about two voxels of the hull."""
# Set by hand on rendered films and the DTU skull.
MOST_DISAGREEMENT = 0.15  # of the mask's area; more is another object, or a part of this one is missing
MOST_AREA_JUMP = 0.3  # from the size that the other views predict
MOST_SIZE_RATIO = 4.0  # to the median mask, where no cameras tell how near the object is
SMALLEST_SHARE = 5e-4  # of the image; a smaller mask is empty
BORDER_SHARE = 0.005  # of the image's circumference; less is a shadow or noise, not a cut object
MIN_GOOD, MIN_GOOD_SHARE = 8, 0.6  # masks that must be good, as a number and as a share of all


@dataclass(frozen=True)
class MaskQuality:
    """Measures of one mask.

    Attributes:
        disagreement: area outside the silhouette that all masks share, and of that silhouette outside the mask, beyond the
            tolerance, over the mask's area; None where no cameras tell what they share.
        area_ratio: its area over that silhouette's, relative to the median view's; without cameras, over the median mask's.
        border_share: of the image's circumference that it touches: the object is cut off there.
        fault: why the mask cannot be used; None for a good one.
    """

    disagreement: float | None
    area_ratio: float
    border_share: float
    fault: str | None


def compare_with_hull(masks: list[np.ndarray], hulls: list[np.ndarray]) -> list[MaskQuality]:
    """Rate (H, W) bool masks by the (H, W) bool silhouettes of their hull."""
    ratios = np.array([mask.sum() / max(hull.sum(), 1) for mask, hull in zip(masks, hulls, strict=True)])
    usual = float(np.median(ratios[ratios > 0])) if (ratios > 0).any() else 1.0
    found = []
    disagreements = map_in_threads(_measure_disagreement, masks, hulls)
    for mask, disagreement, ratio in zip(masks, disagreements, ratios / usual, strict=True):
        fault = None
        if mask.mean() < SMALLEST_SHARE:
            fault = "the mask is empty"
        elif disagreement > MOST_DISAGREEMENT:
            fault = f"{disagreement:.0%} of the mask contradicts the masks of the other views"
        elif abs(ratio - 1) > MOST_AREA_JUMP:
            fault = f"the mask is {ratio:.2f} times as large as the other views predict"
        found.append(MaskQuality(disagreement, float(ratio), measure_border_share(mask), fault))
    return found


def compare_sizes(masks: list[np.ndarray]) -> list[MaskQuality]:
    """Rate (H, W) bool masks without cameras: only empty masks and very different sizes are faults. Registration finds others."""
    areas = np.array([mask.sum() for mask in masks], float)
    usual = float(np.median(areas[areas > 0])) if areas.any() else 1.0
    found = []
    for mask, ratio in zip(masks, areas / usual, strict=True):
        fault = None
        if mask.mean() < SMALLEST_SHARE:
            fault = "the mask is empty"
        elif not 1 / MOST_SIZE_RATIO < ratio < MOST_SIZE_RATIO:
            fault = f"the mask is {ratio:.2f} times as large as the usual one"
        found.append(MaskQuality(None, float(ratio), measure_border_share(mask), fault))
    return found


class MasksRejected(StepError):
    """Too few masks are good; `masks` are all of them, (H, W), and `dropped` the names of the bad ones."""

    def __init__(self, reason: str, masks: list[np.ndarray], dropped: set[str]) -> None:
        super().__init__(reason)
        self.masks, self.dropped = masks, dropped


def check_enough_good(qualities: list[MaskQuality], names: list[str], masks: list[np.ndarray]) -> None:
    """Raise MasksRejected where too few masks, (H, W) bool or float32 above 1/2 on the object, are good."""
    good = sum(quality.fault is None for quality in qualities)
    needed = max(min(MIN_GOOD, len(names)), int(np.ceil(MIN_GOOD_SHARE * len(names))))
    if good < needed:
        faults = [f"{name}: {quality.fault}" for name, quality in zip(names, qualities, strict=True) if quality.fault]
        raise MasksRejected(
            f"only {good} of {len(names)} masks are good, {needed} are needed; put the object alone on a ground of other colours, see that "
            f"it is not moved or taken away during the film, or draw masks and name their folder in objects.tsv. "
            f"{'; '.join(faults[:6])}{' ...' if len(faults) > 6 else ''}",
            [mask > 0.5 for mask in masks],
            {name for name, quality in zip(names, qualities, strict=True) if quality.fault},
        )


def touches_border(quality: MaskQuality) -> bool:
    """Whether the object is cut off at the image's border."""
    return quality.border_share > BORDER_SHARE


def describe_quality(qualities: list[MaskQuality], names: list[str]) -> dict[str, Any]:
    """The measures as they stand in segmentation.json."""
    disagreements = [quality.disagreement for quality in qualities if quality.disagreement is not None]
    return {
        "good_masks": sum(quality.fault is None for quality in qualities),
        "dropped": {name: quality.fault for name, quality in zip(names, qualities, strict=True) if quality.fault},
        "cut_off": [name for name, quality in zip(names, qualities, strict=True) if touches_border(quality)],
        "median_disagreement": _round(float(np.median(disagreements)) if len(disagreements) == len(qualities) else None),
        "masks": {
            name: {
                "disagreement": _round(quality.disagreement),
                "area_ratio": round(quality.area_ratio, 4),
                "border_share": round(quality.border_share, 4),
            }
            for name, quality in zip(names, qualities, strict=True)
        },
    }


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def _measure_disagreement(mask: np.ndarray, hull: np.ndarray) -> float:
    if not mask.any() or not hull.any():
        return 1.0
    return float(find_contradicted(mask, hull).sum() / mask.sum())


def find_contradicted(mask: np.ndarray, hull: np.ndarray) -> np.ndarray:
    """(H, W) bool: where an (H, W) bool mask contradicts the silhouette of the hull that all masks share, beyond the tolerance."""
    radius_px = find_rim_px(mask)
    contradicted = np.zeros_like(mask)
    either = mask | hull
    rows, columns = np.flatnonzero(either.any(1)), np.flatnonzero(either.any(0))
    if len(rows):
        # Around both: a photo is many times as large.
        near = tuple(slice(max(int(found[0]) - radius_px, 0), int(found[-1]) + radius_px + 1) for found in (rows, columns))
        own, shared = mask[near], hull[near]
        # A hull of voxels is as large as the object or larger; it may lack thin parts and fill gaps. Neither is a fault of the mask.
        grown, shrunk = move_rim(shared, radius_px)
        contradicted[near] = (own & ~grown) | (shrunk & ~move_rim(own, radius_px)[0])
    return contradicted


def find_rim_px(mask: np.ndarray) -> int:
    """Width of the rim of an (H, W) bool mask that may differ."""
    return max(1, round(TOLERANCE * float(np.sqrt(mask.sum()))))


def move_rim(mask: np.ndarray, radius_px: int) -> tuple[np.ndarray, np.ndarray]:
    """An (H, W) bool mask, grown and shrunk by `radius_px`; at the image's border it does not shrink."""
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1,) * 2)
    return cv2.dilate(mask.astype(np.uint8), window) > 0, cv2.erode(mask.astype(np.uint8), window, borderValue=1) > 0
