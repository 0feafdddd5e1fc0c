"""Where the sparse points lie that a photo shows: on the ground or far away, or near the middle of the scene and above the ground.

A sheet that the object stands on looks like a thing to a network; its points tell that it is flat.
"""

from collections.abc import Callable

import cv2
import numpy as np

from zeroshop_steps.geometry.support.scene_support import THRESHOLD_DISTANCES, SceneSupport
from zeroshop_steps.segment.scene import Guess, MaskScene

CHANNELS = ("points_raised", "points_known")
REACH = 0.012  # of a point, of the image's width: with more, points beside an object without print speak for what is on it
NEAR = 0.6  # distances of the cameras: points so near to the scene's focus may be the object's, as the finder searches no farther


def prepare(scene: MaskScene, guess: Guess) -> Callable[[int], list[np.ndarray]] | None:
    """How much the points around each pixel are raised, -1 to 1, and how much of them there is, 0 to 1."""
    seen, points, raised = scene.model.seen, scene.model.points, measure_raised(scene, guess)
    if seen is None or raised is None:
        return None

    def see(index: int) -> list[np.ndarray]:
        camera, shown = scene.cameras[index], seen[index]
        rows, columns, _, inside = camera.find_pixels(points[shown])
        sums = np.zeros((2, camera.height_px, camera.width_px), np.float32)
        own, place = raised[shown][inside], (rows[inside], columns[inside])
        np.add.at(sums[0], place, own)
        np.add.at(sums[1], place, np.abs(own))
        sigma = REACH * camera.width_px
        balance, count = (2 * np.pi * sigma**2 * cv2.GaussianBlur(part, (0, 0), sigma) for part in sums)
        return [balance / (count + 1), count / (count + 1)]

    return see


def measure_raised(scene: MaskScene, guess: Guess) -> np.ndarray | None:
    """Whether sparse points, (P,), lie above the ground: 1; on it or far from the scene's focus: -1; 0 of what is mirrored in it.

    Without a ground (choose_ground), None is returned.
    """
    support = choose_ground(scene, guess)
    if support is None:
        return None
    focus, distance = scene.focus
    heights = support.heights(scene.model.points) / (THRESHOLD_DISTANCES * distance)
    # A point of the ground lies within the error of the plane, one of the object above twice that.
    raised = np.where(heights < -1, 0.0, np.clip(2 * heights - 3, -1, 1))
    return np.where(np.linalg.norm(scene.model.points - focus, axis=1) > NEAR * distance, -1.0, raised)


def choose_ground(scene: MaskScene, guess: Guess) -> SceneSupport | None:
    """The guess's plane if points gave it, else the scene's lowest level plane; None where there is none."""
    if guess.support is not None and guess.support.inliers:
        return guess.support
    return scene.planes[-1] if scene.planes else None
