"""Masks of single photos of a thing on a plain table, without a network and without cameras: what differs from the smooth ground.

Over a plain table, colour changes slowly from place to place. A quadratic surface is fitted to the Lab colours around the middle of the
photo, robustly (iteratively reweighted least squares with Cauchy's weights, Holland and Welsch 1977). What differs from it by several
deviations, lies near the middle and does not run out of the photo is the object; GrabCut (Rother et al. 2004) then finds its outline.
Soft shadows are taken off: they have the ground's hue, are darker, and fade into the ground without an edge. A hard shadow, a mirror
image or a thing behind may come along, so these masks lead learned features to the object and vote for it, but never decide alone.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from zeroshop_steps.geometry.channels import sum_channels
from zeroshop_steps.geometry.images import read_image
from zeroshop_steps.networks.object_finder import keep_main_thing

WORK_WIDTH_PX = 240  # finer pictures bring the noise of the camera and cost time
MIDDLE = 0.35  # the share of the way to the border within which the ground is not fitted: there, the object hides it
BORDER = 0.5  # from here on, differences tell how even the ground is
LEAST_DEVIATION = 0.8  # of L, a and b: noise and compression of a perfectly even ground
DIFFERENT = 3.0  # deviations
DARKER = 0.5  # how much darkness alone counts: shadows and mirror images are darker, too
SAME_HUE = 4.0  # deviations of a and b, up to which a darker place may be a shadow
SOFT_STEP = 1.2  # of L, a and b from pixel to pixel, once noise is smoothed: the edge of an object is steeper, that of a soft shadow is not
ITERATIONS, CUTS = 12, 4  # of the fit, and of GrabCut
SURE_PX, FAR_PX = 3, 12  # what lies so deep in the difference is the object, what lies so far from it is not


class GroundContrast:
    """Finds the object in photos of a plain table, as `SalientObjectNetwork` does."""

    name = "ground_contrast"

    def describe(self) -> dict[str, Any]:
        """What its maps depend on."""
        return {"method": self.name}

    def find_maps(self, paths: Sequence[Path], width_px: int) -> list[np.ndarray]:
        """Maps of the object, (h, w) float32, 0 or 1 but for the rim, at most `width_px` wide; all 0 where nothing differs."""
        maps = []
        for path in paths:
            image = read_image(path)
            width = min(width_px, image.shape[1])
            found = find_contrasting_thing(image).astype(np.float32)
            maps.append(cv2.resize(found, (width, round(image.shape[0] * width / image.shape[1]))))
        return maps

    def look_closer(self, paths: Sequence[Path], maps: Sequence[np.ndarray], width_px: int) -> list[np.ndarray]:
        """The maps as they are: what is close to the thing shows too little of the ground."""
        return list(maps)


def find_contrasting_thing(image: np.ndarray) -> np.ndarray:
    """The thing near the middle of an (H, W, 3) RGB photo that differs from the ground around it: (h, w) bool, at most 240 px wide."""
    width = min(WORK_WIDTH_PX, image.shape[1])
    resized = cv2.resize(image, (width, round(image.shape[0] * width / image.shape[1])), interpolation=cv2.INTER_AREA)
    small = np.asarray(cv2.bilateralFilter(resized, 5, 20, 3))
    offset = measure_offset(small)
    different = (weigh_contrast(offset) > DIFFERENT).astype(np.uint8)
    thing = _keep_inner_thing(cv2.morphologyEx(different, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)
    thing = ndimage.binary_fill_holes(cv2.morphologyEx(thing.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8)), np.ones((3, 3)))
    if not thing.any():
        return thing
    thing = cut_outline(small, thing, SURE_PX, FAR_PX)
    lit = thing & ~_find_soft_shadow(resized, thing, offset)
    return keep_main_thing(lit.astype(np.float32)) > 0.5 if lit.any() else thing


def measure_offset(image: np.ndarray) -> np.ndarray:
    """By how many deviations each pixel of an (h, w, 3) RGB photo differs from the smooth ground in L, a and b, (h, w, 3)."""
    height, width = image.shape[:2]
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    colors = cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2LAB).reshape(-1, 3).astype(float)
    out = np.maximum(np.abs(x), np.abs(y)).ravel()
    around = (out > MIDDLE).astype(float)
    weights, offset = around, np.zeros(colors.shape)
    for _ in range(ITERATIONS):
        fit = np.linalg.lstsq(terms * weights[:, None], colors * weights[:, None], rcond=None)[0]
        residual = colors - terms @ fit
        deviation = 1.4826 * np.median(np.abs(residual[out > BORDER]), axis=0) + LEAST_DEVIATION
        offset = residual / deviation
        weights = around / (1 + (weigh_contrast(offset) / 2) ** 2)
    return offset.reshape(height, width, 3)


def weigh_contrast(offset: np.ndarray) -> np.ndarray:
    """(...) contrast by (..., 3) deviations of L, a and b, in which darkness counts less."""
    weighed = offset * np.where(offset[..., :1] < 0, [DARKER, 1.0, 1.0], 1.0)
    return np.sqrt(sum_channels(weighed**2) / 3)


def _find_soft_shadow(image: np.ndarray, thing: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(h, w) bool: what fades into the ground around the thing without an edge, is darker than it and has its hue."""
    lab = cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    numbers = np.arange(thing.size).reshape(thing.shape)
    links = []
    for axis in (0, 1):
        soft = (np.abs(np.diff(lab, axis=axis)) <= SOFT_STEP).all(axis=2)
        links.append(np.stack([part[soft] for part in (np.delete(numbers, -1, axis), np.delete(numbers, 0, axis))]))
    rows, columns = np.concatenate(links, axis=1)
    graph = sparse.coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(thing.size,) * 2)
    _, labels = csgraph.connected_components(graph, directed=False)
    labels = labels.reshape(thing.shape)
    fades = np.isin(labels, np.unique(labels[~thing]))
    return fades & (offset[..., 0] < 0) & (np.linalg.norm(offset[..., 1:], axis=-1) < SAME_HUE)


def _keep_inner_thing(different: np.ndarray) -> np.ndarray:
    """The main thing of an (h, w) bool map, where possible of those that do not run out of the photo, as walls and other things do."""
    _, labels = cv2.connectedComponents(different.astype(np.uint8), connectivity=8)
    rim = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    inner = different & ~np.isin(labels, rim)
    return keep_main_thing((inner if inner.any() else different).astype(np.float32)) > 0.5


def cut_outline(image: np.ndarray, thing: np.ndarray, sure_px: float, far_px: float) -> np.ndarray:
    """The thing, (h, w) bool, cut along colours and edges of the (h, w, 3) RGB photo (GrabCut, Rother et al. 2004).

    What lies more than `sure_px` inside stays the thing, what lies more than `far_px` outside does not become it.
    """
    near = cv2.distanceTransform((~thing).astype(np.uint8), cv2.DIST_L2, 3) <= far_px
    return keep_main_thing(cut_in_band(image, thing, near, sure_px).astype(np.float32)) > 0.5


def cut_in_band(image: np.ndarray, thing: np.ndarray, near: np.ndarray, sure_px: float) -> np.ndarray:
    """(h, w) bool: as `cut_outline`, where `near`, (h, w) bool, may become the thing, and all of its parts are kept."""
    labels = np.where(thing, cv2.GC_PR_FGD, np.where(near, cv2.GC_PR_BGD, cv2.GC_BGD)).astype(np.uint8)
    labels[cv2.distanceTransform(thing.astype(np.uint8), cv2.DIST_L2, 3) > sure_px] = cv2.GC_FGD
    if not ((labels == cv2.GC_FGD).any() and (labels == cv2.GC_BGD).any()):
        return thing
    cv2.setRNGSeed(0)  # GrabCut starts from k-means
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(np.ascontiguousarray(image[..., ::-1]), labels, (0, 0, 1, 1), *models, CUTS, cv2.GC_INIT_WITH_MASK)
    return np.asarray((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))
