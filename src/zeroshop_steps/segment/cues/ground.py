"""What differs from the ground, place by place: from the colours that nearly all views show there."""

from collections.abc import Callable

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.channels import measure_length, sum_channels
from zeroshop_steps.segment.ground_picture import GroundPicture, find_in_front
from zeroshop_steps.segment.scene import Guess, MaskScene

CHANNELS = ("ground_off", "ground_off_in_any_light", "ground_spread", "ground_print", "ground_known")
NOISE_LEVELS = 5.0  # of the camera, added to what the views show
SPREAD_WEIGHT = 1.5  # a median deviation is about two thirds of a standard deviation
SHIFT_PX = 1  # errors of the cameras and of the ground's flatness: a pixel may look like its neighbours in the ground's picture
MOST_SIGMAS, MOST_SPREAD, MOST_PRINT = 6.0, 40.0, 2.0  # where the channels saturate
PRINT_PX = 4.0  # over which print is averaged
LIGHT_RANGE, LIGHT_WINDOW_PX = (0.55, 1.7), 11  # of the light in which a colour may still be the ground's, and over which it is estimated


def prepare(scene: MaskScene, guess: Guess) -> Callable[[int], list[np.ndarray]] | None:
    """Deviations from the ground's colour, as it is and in any light, how far the views differ there, and how much print they agree on.

    Colours agree with a plain ground by chance, too, but print does so only on the ground.
    """
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
    steps = [measure_length(cv2.Sobel(expected, cv2.CV_32F, *axis, scale=0.25)) for axis in ((1, 0), (0, 1))]
    printed = np.minimum(cv2.GaussianBlur(np.hypot(*steps), (0, 0), PRINT_PX) / sigma / MOST_PRINT, 1.0)
    channels = [off, in_any_light, np.minimum(spread / MOST_SPREAD, 1.0), printed]
    return [*(np.where(seen, part, 0.0).astype(np.float32) for part in channels), seen.astype(np.float32)]
