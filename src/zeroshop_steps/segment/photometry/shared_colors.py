"""The colours that photos show at the sparse points which they share."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.channels import take_largest
from zeroshop_steps.geometry.imaging.images import sample_bilinear
from zeroshop_steps.geometry.imaging.srgb import srgb_to_linear
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads

NEIGHBOURS = 10  # nearest points, through which the surface at a point is laid as a plane
RADIUS_WIDTHS = 0.006  # of a disk, in widths of an image, seen straight on from the median distance of its photos
SAMPLES = 24  # of a disk
CLIPPED_LEVEL = 250  # of 255: from here on a pixel may have been brighter than it is stored
CLIPPED_PART = 0.05  # of a disk that makes its colour worthless
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True)
class SharedColors:
    """K colours of points in V photos.

    Attributes:
        photo, point: (K,) indices.
        part: (K,) which of the eight octants of the scene, around the middle of its points, the point lies in.
        light: (K, 3) linear light, 0 to 1.
        clipped: (K,) bool, whether a part of it may have been brighter than it is stored.
    """

    photo: np.ndarray
    point: np.ndarray
    part: np.ndarray
    light: np.ndarray
    clipped: np.ndarray


def sample_shared_colors(model: pycolmap.Reconstruction, views: Sequence[View]) -> SharedColors:
    """What each photo shows around the sparse points that it sees.

    A point's colour is the mean of a small disk of the surface, the same in all photos. A disk of pixels would not do: features are
    the brightest and darkest spots of a print, and look the duller the flatter and the farther a photo sees them.

    Args:
        model: with the points' tracks.
        views: its images, the photos of the result in their order.
    """
    numbers = sorted(model.points3D)
    place = {number: index for index, number in enumerate(numbers)}
    positions = np.array([model.points3D[number].xyz for number in numbers]).reshape(-1, 3)
    images = {image.name: image for image in model.images.values() if image.has_pose}
    tracks = [[place[p.point3D_id] for p in images[view.camera.name].points2D if p.has_point3D()] for view in views]
    seen = [np.unique(np.array(track, int)) for track in tracks]
    disks = _lay_disks(positions, seen, [view.camera for view in views])
    linear = srgb_to_linear(np.arange(256) / 255.0).astype(np.float32)

    def sample(view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pixels = view.image()
        spots = view.camera.project(disks[points].reshape(-1, 3))[0] - 0.5
        shown = sample_bilinear(cv2.GaussianBlur(linear[pixels], (0, 0), 1.0), spots, cv2.BORDER_REPLICATE)
        white = sample_bilinear(take_largest(pixels) >= CLIPPED_LEVEL, spots, cv2.BORDER_REPLICATE)
        return shown.reshape(-1, SAMPLES, 3).mean(1).astype(float), white.reshape(-1, SAMPLES).mean(1) > CLIPPED_PART

    sampled = map_in_threads(sample, views, seen)
    light = np.concatenate([np.zeros((0, 3)), *(each for each, _ in sampled)])
    clipped = np.concatenate([np.zeros(0, bool), *(each for _, each in sampled)])
    photo = np.repeat(np.arange(len(views)), [len(points) for points in seen])
    point = np.concatenate([np.zeros(0, int), *seen])
    part = (positions[point] > np.median(positions[point], 0)) @ [1, 2, 4] if len(point) else point
    return SharedColors(photo, point, part, light, clipped)


def _lay_disks(positions: np.ndarray, seen: list[np.ndarray], cameras: list[Camera]) -> np.ndarray:
    """(P, SAMPLES, 3) places on the surface around P points."""
    if len(positions) < NEIGHBOURS:
        return np.repeat(positions[:, None], SAMPLES, 1)
    around = positions[cKDTree(positions).query(positions, NEIGHBOURS)[1]]
    spread = around - around.mean(1, keepdims=True)
    axes = np.linalg.eigh(np.einsum("pki,pkj->pij", spread, spread))[1][:, :, 1:]
    points = np.concatenate(seen)
    reach = [
        RADIUS_WIDTHS * camera.width_px * camera.project(positions[own])[1] / camera.intrinsics[0, 0]
        for camera, own in zip(cameras, seen, strict=True)
    ]
    order = np.lexsort((np.concatenate(reach), points))
    first, count = (np.searchsorted(points[order], np.arange(len(positions)), side) for side in ("left", "right"))
    radius = np.zeros(len(positions))
    has = count > first
    radius[has] = np.concatenate(reach)[order][((first + count - 1) // 2)[has]]
    # Spread evenly over the disk (Vogel 1979).
    turn, out = GOLDEN_ANGLE * np.arange(SAMPLES), np.sqrt((np.arange(SAMPLES) + 0.5) / SAMPLES)
    spiral = np.stack([np.cos(turn), np.sin(turn)], 1) * out[:, None]
    return positions[:, None] + radius[:, None, None] * np.einsum("sa,pia->psi", spiral, axes)
