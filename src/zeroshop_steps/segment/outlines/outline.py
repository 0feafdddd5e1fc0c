"""Move the outline of a mask to where the photo changes from the object's colour to that of what lies around it.

A pixel at the edge of the object shows both in part. It differs from the ground already where a tenth of it is covered, and all that finds
masks takes such pixels along, at the width at which photos are cut: masks are too large by half a pixel of that all around. So the outline
is found anew at the photo's own resolution: a pixel belongs to the object if its colour is nearer to that of the object next to it than to
that of the ground next to it, which is where its coverage is one half (the compositing equation of matting; Wang and Cohen 2007).
"""

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.imaging.channels import sum_channels

# Set on the film of YCB-V's sugar box on a dark table.
REACH_CUTS = 1.75  # how far an outline may move, in pixels of the width at which the mask was cut
LEAST_REACH_PX = 2.5  # and at least so far: what is nearer is mixed by the lens and by the video's compression
MOST_CUT_PX = 3.0  # of the photo in a pixel of the mask; larger photos are looked at so much smaller
SAMPLE_PX = 3  # width over which a colour is averaged
CONTRAST_LEVELS = (15.0, 30.0)
"""Between the two colours, rms of the channels, levels of 255: up to the first the mask decides, from the second on the photo does."""
SMOOTH_PX = 0.7  # standard deviation over which coverages are averaged


def follow_edges(mask: np.ndarray, image: np.ndarray) -> np.ndarray:
    """The (H, W) bool mask of a photo by its mask at the width at which it was cut.

    Where parts are too thin to show their own colour, or have that of what lies around them, the outline stays where it was.

    Args:
        mask: (h, w) float32, above 1/2 on the object; no wider than the photo.
        image: (H, W, 3) uint8 RGB of the same part of the scene.
    """
    height, width = image.shape[:2]
    if not (mask > 0.5).any():
        return np.zeros((height, width), bool)
    cut_px = width / mask.shape[1]
    scale = min(MOST_CUT_PX / cut_px, 1.0)
    size = (round(width * scale), round(height * scale))
    small = cv2.resize(mask, size, interpolation=cv2.INTER_LINEAR)
    covered = _measure_coverage(
        small, cv2.resize(image, size, interpolation=cv2.INTER_AREA), max(REACH_CUTS * cut_px * scale, LEAST_REACH_PX)
    )
    return cv2.resize(covered, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5


def _measure_coverage(mask: np.ndarray, image: np.ndarray, reach_px: float) -> np.ndarray:
    """(H, W) float32 from 0 to 1: the mask, (H, W) float32, and how much of each pixel near its outline the object covers."""
    inside = mask > 0.5
    rows, columns = np.nonzero(inside)
    margin = int(3 * reach_px + SAMPLE_PX)
    crop = tuple(slice(max(int(part.min()) - margin, 0), int(part.max()) + margin + 1) for part in (rows, columns))
    own, photo = inside[crop], image[crop].astype(np.float32)
    within, beyond = (cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 5) > reach_px for part in (own, ~own))
    if not (within.any() and beyond.any()):
        return mask
    (color, near), (ground, ground_near) = (_take_nearest(part, photo, reach_px) for part in (within, beyond))
    way = color - ground
    squared = sum_channels(way**2)
    contrast = np.sqrt(squared / 3)
    share = np.clip(sum_channels((photo - ground) * way) / np.maximum(squared, 1e-6), 0.0, 1.0)
    sure = np.clip((contrast - CONTRAST_LEVELS[0]) / (CONTRAST_LEVELS[1] - CONTRAST_LEVELS[0]), 0.0, 1.0) * (near & ground_near)
    share = np.where(within, 1.0, np.where(beyond, 0.0, sure * share + (1 - sure) * own)).astype(np.float32)
    share = np.asarray(cv2.GaussianBlur(share, (0, 0), SMOOTH_PX))
    result = mask.copy()
    result[crop] = np.where(within | beyond, mask[crop], share)
    return result


def _take_nearest(region: np.ndarray, photo: np.ndarray, reach_px: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) colours of an (H, W) bool region at its place that is nearest to each pixel, and (H, W) bool: it is near."""
    weight = region.astype(np.float32)
    window = (SAMPLE_PX, SAMPLE_PX)
    mean = cv2.blur(photo * weight[..., None], window) / np.maximum(cv2.blur(weight, window), 1e-6)[..., None]
    distance, places = ndimage.distance_transform_edt(~region, return_indices=True)
    return mean[tuple(places)], distance <= 2 * reach_px + 2
