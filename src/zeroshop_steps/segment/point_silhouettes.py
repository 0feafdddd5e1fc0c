"""Masks of a thing that stands where no ground can be told, such as a head on a pedestal in a room, by its own sparse points.

Print or grain all over the thing gives it sparse points all over, in one dense cluster around the point that the cameras look at. What is
around it is far behind. So the silhouette of the cluster is that of the thing, but for a narrow band along its rim, in which the outline of
each photo is found. A thing with large plain parts has no such silhouette: then its masks contradict each other.
"""

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.scene_support import find_plane_axes, find_scene_focus
from zeroshop_steps.geometry.support_plane import MIN_CERTAINTY, estimate_up_from_roll
from zeroshop_steps.register.ground_contrast import cut_outline
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.plane_search import LOWEST_PERCENTILE, find_thing
from zeroshop_steps.segment.windows import cut_views, take_whole

WIDTH_PX = 320  # of the photos that are cut; time grows with its square
# Lengths are shares of the cameras' distance. Set on the photos of a marble head (docs/results.md).
LINK_DISTANCES = 0.06  # points this close to each other are of one thing: smooth parts have few
MOST_RADIUS = 0.35  # of a thing that fits into the photos
LONG_RADIUS, ACROSS_RADIUS = 0.6, 0.25  # of one that is long or tall, such as a statue: about its middle, and its longest axis
LEAST_SHARE = 0.5  # of the points around what the cameras look at; with fewer, they show several things, or the ground
FLAT_SHARE = 0.15  # of the thing's height: columns that rise less are on what it stands on
BAND_SHARE = 0.07  # of the square root of its area: half the width of the band in which the outline is looked for


def find_point_silhouettes(views: list[View], model: SparseModel) -> list[np.ndarray]:
    """Maps of the thing that the cameras look at, (h, w) float32, 0 or 1, at most `WIDTH_PX` wide.

    Raises:
        StepError: there is no single dense cluster of points.
    """
    thing, distance = find_single_thing(model)
    middle = thing.mean(0)
    up, certainty = estimate_up_from_roll(views)
    if certainty >= MIN_CERTAINTY:
        thing = drop_flat_columns(thing, up, LINK_DISTANCES * distance)
    maps = []
    for camera, image in zip(*cut_views(views, take_whole(views), WIDTH_PX), strict=True):
        gap_px = measure_gap_px(camera, middle, distance)
        silhouette = draw_silhouette(thing, camera, gap_px)
        band_px = BAND_SHARE * float(np.sqrt(silhouette.sum()))
        maps.append(cut_outline(image.astype(np.uint8), silhouette, band_px, band_px).astype(np.float32))
    return maps


def find_single_thing(model: SparseModel) -> tuple[np.ndarray, float]:
    """The points (P, 3) of the single thing that the cameras look at, and their distance.

    Raises:
        StepError: there is no single dense cluster of points.
    """
    focus, distance = find_scene_focus(model)
    found = find_thing(model.points, focus, distance, LINK_DISTANCES)
    if found is None:
        raise StepError("what the cameras look at has too few points to be told by them")
    thing, near_count = found
    away = thing - thing.mean(0)
    axis = np.linalg.svd(away, full_matrices=False)[2][0]
    radius, across = (float(np.percentile(np.linalg.norm(part, axis=1), 90)) / distance for part in (away, np.cross(away, axis)))
    share = len(thing) / near_count
    if share < LEAST_SHARE or radius > (LONG_RADIUS if across < ACROSS_RADIUS else MOST_RADIUS):
        raise StepError(f"the points that the cameras look at are no single thing: {share:.0%} of them are in a cluster of {radius:.2f}")
    return thing, distance


def measure_gap_px(camera: Camera, middle: np.ndarray, distance: float) -> float:
    """How far points of one thing around a middle, (3,), may lie apart in a view, by how far the cameras are away."""
    depth = float((camera.camera_from_world[:3, :3] @ middle + camera.camera_from_world[:3, 3])[2])
    return LINK_DISTANCES * distance * float(camera.intrinsics[0, 0]) / max(depth, 1e-9)


def drop_flat_columns(points: np.ndarray, up: np.ndarray, width: float) -> np.ndarray:
    """Those of (P, 3) points that stand in columns, as wide as `width`, that rise: labels and print beside the thing are flat."""
    heights = points @ up
    lowest, highest = np.percentile(heights, [LOWEST_PERCENTILE, 100 - LOWEST_PERCENTILE])
    _, column = np.unique(np.floor(points @ find_plane_axes(up).T / width).astype(int), axis=0, return_inverse=True)
    tops = np.full(column.max() + 1, -np.inf)
    np.maximum.at(tops, column.ravel(), heights)
    kept: np.ndarray = points[tops[column.ravel()] > lowest + FLAT_SHARE * (highest - lowest)]
    return kept


def draw_silhouette(points: np.ndarray, camera: Camera, gap_px: float) -> np.ndarray:
    """(H, W) bool: what (P, 3) points on a surface cover, where gaps between them are up to twice `gap_px` wide."""
    margin = max(1, int(np.ceil(gap_px)))  # gaps at the border are closed by points beyond it
    wide = camera.cropped(-margin, -margin, camera.width_px + 2 * margin, camera.height_px + 2 * margin)
    rows, columns, _, inside = wide.find_pixels(points)
    drawn = np.zeros((wide.height_px, wide.width_px), np.uint8)
    drawn[rows[inside], columns[inside]] = 1
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1,) * 2)
    closed = cv2.copyMakeBorder(drawn, *(margin,) * 4, cv2.BORDER_CONSTANT, value=0)  # what is closed must not grow at the border
    closed = cv2.morphologyEx(closed, cv2.MORPH_CLOSE, disk)[2 * margin : -2 * margin, 2 * margin : -2 * margin]
    filled: np.ndarray = ndimage.binary_fill_holes(closed)
    return filled
