"""What differs from the ground, place by place: from the colours that nearly all views show there."""

from collections.abc import Callable

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.channels import measure_length, sum_channels
from zeroshop_steps.segment.ground_picture import GroundPicture, find_in_front
from zeroshop_steps.segment.scene import Guess, MaskScene

CHANNELS = ("ground_off", "ground_off_in_any_light", "ground_spread", "ground_known")
NOISE_LEVELS = 5.0  # of the camera, added to what the views show
SPREAD_WEIGHT = 1.5  # a median deviation is about two thirds of a standard deviation
SHIFT_PX = 1  # errors of the cameras and of the ground's flatness: a pixel may look like its neighbours in the ground's picture
MOST_SIGMAS, MOST_SPREAD = 6.0, 40.0  # where the channels saturate
LIGHT_RANGE, LIGHT_WINDOW_PX = (0.55, 1.7), 11  # of the light in which a colour may still be the ground's, and over which it is estimated


def prepare(scene: MaskScene, guess: Guess) -> Callable[[int], list[np.ndarray]] | None:
    """Deviations from the ground's colour, as it is and in any light, and how far the views differ there."""
    picture = guess.ground
    if picture is None:
        return None
    return lambda index: _compare(picture, scene, index)


def _compare(picture: GroundPicture, scene: MaskScene, index: int) -> list[np.ndarray]:
    camera, image = scene.cameras[index], scene.images[index]
    homography = picture.view_from_cell(camera)
    size_px = (camera.width_px, camera.height_px)
    expected, spread, known = (
        cv2.warpPerspective(part, homography, size_px, flags=cv2.INTER_LINEAR)
        for part in (picture.color, picture.spread, picture.known.astype(np.float32))
    )
    sigma = NOISE_LEVELS + SPREAD_WEIGHT * spread
    window = np.ones((2 * SHIFT_PX + 1,) * 2, np.uint8)
    highest, lowest = cv2.dilate(expected, window), cv2.erode(expected, window)
    both, own = (cv2.blur(sum_channels(part * expected), (LIGHT_WINDOW_PX,) * 2) for part in (image, expected))
    light = np.clip(both / np.maximum(own, 1.0), *LIGHT_RANGE)[..., None]
    off, in_any_light = (
        np.minimum(measure_length(np.maximum(np.maximum(image - top, bottom - image), 0)) / sigma / MOST_SIGMAS, 1.0)
        for top, bottom in ((highest, lowest), (light * highest, light * lowest))
    )
    seen = (known > 0.99) & find_in_front(camera, homography)
    channels = [off, in_any_light, np.minimum(spread / MOST_SPREAD, 1.0)]
    return [*(np.where(seen, part, 0.0).astype(np.float32) for part in channels), seen.astype(np.float32)]
