"""Compare regions with the views of the objects, and estimate the probability that a region shows each of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from zeroshop_steps.detect.contour.descriptors import Descriptors, RegionPatch, describe_patches, linear_rgb, make_region_patch
from zeroshop_steps.detect.templates import Templates

# Chosen on six virtual tables of the demo objects, the test set with seed 1 (docs/results.md, "Detection and poses").
TURNS = 18  # in-plane rotations of each view, 20 degrees apart
SMALLEST_SHARE, LARGEST_SHARE = 0.08, 1.5  # of a region's area in the views' smallest and largest; others are not compared
LONGEST_DIAMETERS = 1.35  # of the diagonal of a region's box; a box around an object can be 1.41 times as long as the object
MIN_CELLS = 1e-3  # of overlap or coverage; avoids divisions by zero
VIEW_NAMES = ("overlap", "relief", "gradients", "histogram", "any_histogram")  # the last one: of the view whose colours fit best
# Logistic regression over the measures that these names list.
VIEW_WEIGHTS = np.array([9.28, -6.11, 2.57, 6.75, 14.37])
REGION_WEIGHTS, CONSTANT = np.array([7.21, 3.96]), -36.24


@dataclass(frozen=True)
class ReferenceViews:
    """Descriptors of the views of one object.

    Attributes:
        diameter_mm: of the object.
        views: of V views in T in-plane rotations each; the rotations of a view follow one another.
        areas_mm2: (V,) areas of the views' silhouettes.
    """

    diameter_mm: float
    views: Descriptors
    areas_mm2: np.ndarray


def describe_reference(templates: Templates, diameter_mm: float) -> ReferenceViews:
    """Describe the views of one object."""
    focal_px = float(templates.intrinsics[0, 0])
    patches = [
        make_region_patch(depth > 0, linear_rgb(color), depth, focal_px)
        for color, depth in zip(templates.colors, templates.depths_mm, strict=True)
    ]
    return ReferenceViews(diameter_mm, describe_patches(patches, diameter_mm, TURNS), np.array([patch.area_mm2 for patch in patches]))


def match_views(patches: Sequence[RegionPatch], reference: ReferenceViews) -> tuple[np.ndarray, np.ndarray]:
    """Compare regions with the view that fits each best.

    Returns:
        indices: (M,) of the patches whose size allows this object.
        measures: (M, len(VIEW_NAMES)) how each agrees with its best view.
    """
    areas = np.array([patch.area_mm2 for patch in patches])
    lengths = np.array([patch.length_mm for patch in patches])
    low, high = reference.areas_mm2.min() * SMALLEST_SHARE, reference.areas_mm2.max() * LARGEST_SHARE
    indices = np.flatnonzero((areas > low) & (areas < high) & (lengths < LONGEST_DIAMETERS * reference.diameter_mm))
    if not len(indices):
        return indices, np.zeros((0, len(VIEW_NAMES)))
    regions = describe_patches([patches[index] for index in indices.tolist()], reference.diameter_mm)
    all_measures = _measure_all(regions, reference)
    best = (all_measures @ VIEW_WEIGHTS).argmax(1)
    return indices, all_measures[np.arange(len(indices)), best]


def estimate_confidences(patches: Sequence[RegionPatch], edges: np.ndarray, references: Mapping[int, ReferenceViews]) -> np.ndarray:
    """(patches, objects) probabilities that a region shows an object, and all of it. In a row, they and that of no object add up to 1.

    Args:
        patches: the regions.
        edges: (patches, len(REGION_NAMES)) strengths of the edges around each region and within it.
        references: the objects.
    """
    odds = np.full((len(patches), len(references)), -np.inf)
    of_region = edges @ REGION_WEIGHTS + CONSTANT
    for column, reference in enumerate(references.values()):
        indices, measures = match_views(patches, reference)
        odds[indices, column] = measures @ VIEW_WEIGHTS + of_region[indices]
    return softmax(np.concatenate([odds, np.zeros((len(patches), 1))], 1), axis=1)[:, :-1]


def _measure_all(regions: Descriptors, reference: ReferenceViews) -> np.ndarray:
    """(regions, views, len(VIEW_NAMES)) measures of all pairs."""
    views = reference.views
    common = np.maximum(regions.mask @ views.mask.T, MIN_CELLS)
    union = regions.mask.sum(1)[:, None] + views.mask.sum(1) - common
    relief = _masked_square_distances(regions.mask, regions.relief, views.mask, views.relief) / common
    histogram = regions.histogram @ views.histogram.T
    measures = [
        common / union,
        np.sqrt(np.maximum(relief, 0)),
        regions.gradients @ views.gradients.T,
        histogram,
        np.broadcast_to(histogram.max(1, keepdims=True), histogram.shape),
    ]
    return np.stack(measures, -1)


def _masked_square_distances(mask: np.ndarray, values: np.ndarray, other_mask: np.ndarray, other_values: np.ndarray) -> np.ndarray:
    """(N, M) sums over cells of mask x other mask x squared difference. The values are already multiplied by their masks."""
    squares, other_squares = values**2 / np.maximum(mask, MIN_CELLS), other_values**2 / np.maximum(other_mask, MIN_CELLS)
    return squares @ other_mask.T + mask @ other_squares.T - 2 * (values @ other_values.T)
