"""Straighten cameras that are bent, by the outlines of the masks that were found with them.

On a plain table, a few hundred points fit to cameras that are bent as a whole: the bend is what the matches hardly feel. Outlines feel it,
as rays through the rim of one mask miss the others. So both are adjusted together. Masks may be wrong, too, and would then bend cameras
that are right. Such an adjustment shows: the outlines still miss each other, or the matches fit worse than before.
"""

from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera, fit_similarity
from zeroshop_steps.register.scene.image_set import MIN_IMAGES, REFERENCE_PX
from zeroshop_steps.register.silhouettes.coherence import UNEXPLAINED_PX, find_wrong_masks, measure_silhouette_coherence, shrink_masks
from zeroshop_steps.register.silhouettes.model_adjustment import adjust_model_by_masks
from zeroshop_steps.runtime.errors import warn

WRONG_SHARE = 0.25  # of the masks may be wrong and do not count; if more contradict the others, cameras are
MOST_MISSED_PX = 3.0
"""Median over the photos, in pixels of a photo of 1000. Right cameras had 0 to 1.0 (bananas, rendered films on plain tables), also
where a mask or a camera was wrong; cameras that were bent by 3 % of their distance 6.9."""

MOST_ERROR_GROWTH = 1.2
"""Of the mean reprojection error. Adjusting bent cameras made it 1.05 to 1.17 times as large, wrong masks 1.36 to 200 times."""


@dataclass(frozen=True)
class Straightened:
    """Cameras that fit the outlines.

    Attributes:
        model: the adjusted model; the old one where the cameras were left alone.
        cameras: of the views, likewise.
        missed_px: by how much the outlines miss each other, as `measure_silhouette_misses_px` gives it.
        before_px: the same with the old cameras, where they were adjusted.
    """

    model: pycolmap.Reconstruction
    cameras: list[Camera]
    missed_px: float | None
    before_px: float | None = None


def straighten_cameras(
    model: pycolmap.Reconstruction, cameras: list[Camera], masks: list[np.ndarray], missed_px: float | None = None
) -> Straightened:
    """Adjust cameras whose outlines miss each other, and keep that where outlines and matches then fit.

    Args:
        model: pinhole cameras and their points.
        cameras: its cameras with a pose.
        masks: (H, W) bool in their order and size.
        missed_px: by how much the outlines miss each other, where that was measured already.
    """
    if missed_px is None:
        missed_px = measure_silhouette_misses_px(cameras, masks)
    if missed_px is None or missed_px <= MOST_MISSED_PX:
        return Straightened(model, cameras, missed_px)
    adjusted = adjust_model_by_masks(model, cameras, {camera.name: mask for camera, mask in zip(cameras, masks, strict=True)})
    left_px = measure_silhouette_misses_px(adjusted.cameras, masks)
    error_before_px, error_after_px = adjusted.error_px
    if left_px is None or left_px > MOST_MISSED_PX or error_after_px > MOST_ERROR_GROWTH * error_before_px:
        return Straightened(model, cameras, missed_px)
    return Straightened(adjusted.model, adjusted.cameras, left_px, missed_px)


def warn_of_bent_cameras(straightened: Straightened) -> None:
    """Warn of cameras that were adjusted, and where the outlines of most photos miss each other."""
    if straightened.before_px is not None:
        warn(
            f"the cameras were bent: the outlines of the masks missed each other by {straightened.before_px:.1f} px (of 1000), by"
            f" {straightened.missed_px:.1f} since the cameras were adjusted to them"
        )
    warn_of_misses(straightened.missed_px)


def carry_plane(normal: np.ndarray, offset: float, before: list[Camera], after: list[Camera]) -> tuple[np.ndarray, float]:
    """The plane {x: normal @ x = offset} by the similarity that best maps the old cameras to the new ones."""
    similarity = fit_similarity(*(np.array([camera.centre_in_world for camera in cameras]) for cameras in (before, after)))
    carried = similarity[:3, :3] @ normal
    scale = float(np.linalg.norm(carried))
    return carried / scale, scale * offset + float(carried / scale @ similarity[:3, 3])


def measure_silhouette_misses_px(cameras: list[Camera], masks: list[np.ndarray]) -> float | None:
    """By how much the rays of a mask miss those of other views: the median view, in pixels of a photo of 1000. None for two views.

    Args:
        cameras: of the registered photos.
        masks: (H, W) bool in their order and size.
    """
    if len(cameras) < MIN_IMAGES:
        return None
    cameras = [replace(camera, name=str(index)) for index, camera in enumerate(cameras)]
    cameras, small = shrink_masks(cameras, {camera.name: mask for camera, mask in zip(cameras, masks, strict=True)})
    seen = [camera for camera in cameras if small[camera.name].any()]
    if len(seen) < MIN_IMAGES:
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
