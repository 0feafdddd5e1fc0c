"""Descriptors of regions and of template views, both cropped at the same scale in mm: size, shape, colours and gradients.

Each region is scaled to the same mean luminance, so that the light does not matter. Colours are described by a histogram of the
region, gradients by histograms of orientations in a grid (Dalal and Triggs 2005).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from zeroshop_steps.synthetic.rendering.textures import LINEAR_OF_BYTE

# Chosen on six virtual tables of the demo objects, the test set with seed 1 (docs/results.md, "Detection and poses").
CROP_PX = 48  # side of a crop
CROP_DIAMETERS = 1.3  # the same side in diameters of the object, which leaves room around its centroid
CELLS = 24  # along a side, in which mask and relief are averaged
PART = 32  # crops that are described at a time; more would not fit in the processor's cache
MEAN_LUMINANCE = 0.25  # of 1, to which a region is scaled: bright enough for its colours, and highlights are clipped only
RELIEF_MM = 1000.0  # depth relative to the median is clipped to this; it is only bounded so that outliers do not smear when resampled
ORIENTATIONS, BLOCKS = 8, 6  # bins of half a turn, and blocks along a side
INSIDE = 0.98  # least mask value at a pixel and its four neighbours; gradients at the region's own border do not count
LIGHT_BINS, CHROMA_BINS, CHROMA_RANGE = 5, 9, 72.0  # bins of L, and of a and b from -72 to 72; stronger colours share the last bin
TINY = np.float32(1e-3)  # share of a pixel that is covered, below which its colour is not divided by it
# Of linear light (ITU-R BT.709).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass(frozen=True)
class RegionPatch:
    """A region of an image or of a view, in the (rows, columns) around it.

    Attributes:
        layers: (rows, columns, 5) float32: mask, linear red, green and blue, depth in mm relative to `depth_mm`; 0 outside the region.
        middle_px: (x, y) centroid of the region.
        mm_per_px: at the depth of the region.
        depth_mm: median depth of the region.
    """

    layers: np.ndarray
    middle_px: tuple[float, float]
    mm_per_px: float
    depth_mm: float

    @property
    def area_mm2(self) -> float:
        """Area of the region."""
        return float(self.layers[..., 0].sum()) * self.mm_per_px**2

    @property
    def length_mm(self) -> float:
        """Diagonal of the region's box."""
        return float(np.hypot(*self.layers.shape[:2])) * self.mm_per_px


@dataclass(frozen=True)
class Descriptors:
    """Descriptors of N crops; cells are row by row.

    Attributes:
        mask: (N, cells) covered share of each cell.
        relief: (N, cells) depth relative to the median in diameters, multiplied by `mask`.
        gradients: (N, D) unit vectors, histograms of orientations.
        histogram: (N, B) square roots of the shares of colours.
    """

    mask: np.ndarray
    relief: np.ndarray
    gradients: np.ndarray
    histogram: np.ndarray


def make_region_patch(mask: np.ndarray, linear: np.ndarray, depth_mm: np.ndarray, focal_px: float) -> RegionPatch:
    """A patch from its (rows, columns) bool mask, which must not be empty, linear RGB 0..1, and depth."""
    middle_mm = float(np.median(depth_mm[mask]))
    relief = np.clip(depth_mm - middle_mm, -RELIEF_MM, RELIEF_MM)
    layers = np.concatenate([np.ones_like(relief)[..., None], linear, relief[..., None]], -1) * mask[..., None]
    rows, columns = np.nonzero(mask)
    return RegionPatch(layers.astype(np.float32), (float(columns.mean()), float(rows.mean())), middle_mm / focal_px, middle_mm)


def linear_rgb(image: np.ndarray) -> np.ndarray:
    """(height, width, 3) float32 linear light, 0..1, of an sRGB uint8 image."""
    return LINEAR_OF_BYTE[image]


def describe_patches(patches: Sequence[RegionPatch], diameter_mm: float, turns: int = 1) -> Descriptors:
    """Descriptors of patches for an object of this diameter; each in `turns` even in-plane rotations, one after the other."""
    side_mm = CROP_DIAMETERS * diameter_mm
    crops = np.concatenate([_cut_crops(patch, side_mm, turns) for patch in patches])
    parts = [_describe_crops(crops[start : start + PART], diameter_mm) for start in range(0, len(crops), PART)]
    return Descriptors(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _describe_crops(crops: np.ndarray, diameter_mm: float) -> tuple[np.ndarray, ...]:
    """The fields of `Descriptors` of (N, CROP_PX, CROP_PX, 5) crops."""
    masks = crops[..., 0]
    weight = np.maximum(masks, TINY)
    luminance = (crops[..., 1:4] @ LUMINANCE).sum((1, 2)) / np.maximum(masks.sum((1, 2)), 1e-3)
    gain = MEAN_LUMINANCE / np.maximum(luminance, 1e-4)
    scaled = np.minimum(crops[..., 1:4] * (gain[:, None, None] / weight)[..., None], np.float32(1))
    lab = cv2.cvtColor(scaled.reshape(-1, CROP_PX, 3), cv2.COLOR_LRGB2LAB).reshape(scaled.shape)
    relief = np.clip(crops[..., 4] / diameter_mm, -1, 1)
    return (
        _average_cells(masks),
        _average_cells(relief),
        _gradient_histograms(lab[..., 0], masks),
        _color_histograms(lab, masks),
    )


def _cut_crops(patch: RegionPatch, side_mm: float, turns: int) -> np.ndarray:
    """(turns, CROP_PX, CROP_PX, 5) crops of the patch around its centroid."""
    px_per_px = side_mm / CROP_PX / patch.mm_per_px  # pixels of the patch per pixel of the crop
    layers, (x, y) = patch.layers, patch.middle_px
    while px_per_px >= 2 and min(layers.shape[:2]) > 3:
        height, width = layers.shape[0] // 2 * 2, layers.shape[1] // 2 * 2
        layers = cv2.resize(layers[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        px_per_px, x, y = px_per_px / 2, (x - 0.5) / 2, (y - 0.5) / 2
    half = (CROP_PX - 1) / 2
    crops = np.empty((turns, CROP_PX, CROP_PX, 5), np.float32)
    for turn, angle in enumerate(np.arange(turns) * 2 * np.pi / turns):
        cosine, sine = px_per_px * np.cos(angle), px_per_px * np.sin(angle)
        matrix = np.array([[cosine, -sine, x - half * (cosine - sine)], [sine, cosine, y - half * (sine + cosine)]])
        crops[turn] = cv2.warpAffine(layers, matrix, (CROP_PX, CROP_PX), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return crops


def _average_cells(values: np.ndarray) -> np.ndarray:
    """(N, cells) means over the cells of (N, CROP_PX, CROP_PX) values."""
    size = CROP_PX // CELLS
    return values.reshape(len(values), CELLS, size, CELLS, size).mean((2, 4)).reshape(len(values), -1).astype(np.float32)


def _gradient_histograms(light: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """(N, D) histograms of gradient orientations in a grid of blocks, inside the masks only."""
    inside = np.minimum.reduce([np.roll(masks, shift, axis) for axis in (1, 2) for shift in (-1, 0, 1)]) > INSIDE
    down, right = (np.roll(light, -1, axis) - np.roll(light, 1, axis) for axis in (1, 2))
    strength = np.hypot(down, right) * inside
    position = np.mod(np.arctan2(down, right), np.pi) / np.pi * ORIENTATIONS
    first = np.floor(position).astype(int) % ORIENTATIONS
    share = position - np.floor(position)
    size = CROP_PX // BLOCKS
    rows = np.arange(CROP_PX) // size
    index = ((np.arange(len(light))[:, None, None] * BLOCKS + rows[:, None]) * BLOCKS + rows) * ORIENTATIONS
    count = len(light) * BLOCKS * BLOCKS * ORIENTATIONS
    sums = np.bincount((index + first).ravel(), (strength * (1 - share)).ravel(), count)
    sums += np.bincount((index + (first + 1) % ORIENTATIONS).ravel(), (strength * share).ravel(), count)
    vectors = np.sqrt(sums.reshape(len(light), -1))
    return (vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-6)).astype(np.float32)


def _color_histograms(lab: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """(N, B) joint histograms of lightness and chroma, blurred a little so that similar colours agree."""
    light = np.clip(lab[..., 0] / 100 * LIGHT_BINS, 0, LIGHT_BINS - 1e-3).astype(int)
    chroma = np.clip((lab[..., 1:] / CHROMA_RANGE + 1) / 2 * CHROMA_BINS, 0, CHROMA_BINS - 1e-3).astype(int)
    index = (light * CHROMA_BINS + chroma[..., 0]) * CHROMA_BINS + chroma[..., 1]
    bins = LIGHT_BINS * CHROMA_BINS * CHROMA_BINS
    index = index + np.arange(len(lab))[:, None, None] * bins
    sums = np.bincount(index.ravel(), masks.ravel(), len(lab) * bins).reshape(-1, LIGHT_BINS, CHROMA_BINS, CHROMA_BINS)
    for axis in (1, 2, 3):
        # Blurred, so that similar colours in neighbouring bins are alike.
        sums = gaussian_filter1d(sums, 0.7, axis, mode="constant")
    shares = sums.reshape(len(lab), -1)
    return np.sqrt(shares / np.maximum(shares.sum(1, keepdims=True), 1e-6)).astype(np.float32)
