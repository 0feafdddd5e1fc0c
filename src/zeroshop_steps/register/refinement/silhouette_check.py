"""Check the cameras by the outlines of masks that were found with them: where all outlines miss each other, the cameras are bent."""

from dataclasses import replace

import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.register.scene.image_set import REFERENCE_PX
from zeroshop_steps.register.silhouettes.coherence import UNEXPLAINED_PX, find_wrong_masks, measure_silhouette_coherence, shrink_masks
from zeroshop_steps.runtime.errors import warn

LEAST_VIEWS = 3  # two outlines nearly always fit
WRONG_SHARE = 0.25  # of the masks may be wrong and do not count; if more contradict the others, cameras are
MOST_MISSED_PX = 3.0
"""Median over the photos, in pixels of a photo of 1000. Right cameras had 0 to 1.0 (bananas, rendered films on plain tables), also
where a mask or a camera was wrong; cameras that were bent by 3 % of their distance 6.9."""


def measure_silhouette_misses_px(cameras: list[Camera], masks: list[np.ndarray]) -> float | None:
    """By how much the rays of a mask miss those of other views: the median view, in pixels of a photo of 1000. None for two views.

    Args:
        cameras: of the registered photos.
        masks: (H, W) bool in their order and size.
    """
    if len(cameras) < LEAST_VIEWS:
        return None
    cameras = [replace(camera, name=str(index)) for index, camera in enumerate(cameras)]
    cameras, small = shrink_masks(cameras, {camera.name: mask for camera, mask in zip(cameras, masks, strict=True)})
    seen = [camera for camera in cameras if small[camera.name].any()]
    if len(seen) < LEAST_VIEWS:
        return None
    wrong = find_wrong_masks(seen, small, np.full(len(seen), UNEXPLAINED_PX))
    if len(wrong) <= WRONG_SHARE * len(seen):
        seen = [camera for camera in seen if camera.name not in wrong]
    scales = np.array([max(camera.width_px, camera.height_px) / REFERENCE_PX for camera in seen])
    return float(np.median(measure_silhouette_coherence(seen, small).unexplained_px / scales))


def warn_of_misses(missed_px: float | None) -> None:
    """Warn where the outlines of most photos miss each other."""
    if missed_px is not None and missed_px > MOST_MISSED_PX:
        warn(
            f"the outlines of the photos do not fit together: by half of them they miss each other by {missed_px:.1f} px or more (of 1000),"
            f" {MOST_MISSED_PX:g} are usual at most. The cameras are bent, or the masks are wrong: look at contact_sheet.png. If the masks"
            " are right, put the object on a surface with more print and take the photos again"
        )
