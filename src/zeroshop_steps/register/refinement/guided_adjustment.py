"""Adjust cameras that outlines placed by what the pictures show along the visual hull: outlines alone leave them about 0.2 degrees off."""

from typing import Any

import cv2
import pycolmap

from zeroshop_steps.geometry.images import read_image
from zeroshop_steps.register.refinement.guided_matching import match_along_hull
from zeroshop_steps.register.refinement.keypoint_refinement import LEAST_ALIGNED
from zeroshop_steps.register.scene.image_set import REFERENCE_PX, ImageSet
from zeroshop_steps.register.scene.undistortion import undistort_masks
from zeroshop_steps.register.silhouettes.model_adjustment import adjust_model_by_masks, replace_tracks
from zeroshop_steps.register.silhouettes.state import TrackKind

PLAY_PX = (12, 7)  # of each round: how far from where the cameras say a corner is looked for, per 1000 px of the image
MOST_ERROR_PX, LEAST_ANGLE_DEG = 4.0, 1.5  # points with a larger error, likewise, or a smaller angle between their rays are left out


def adjust_by_guided_tracks(model: pycolmap.Reconstruction, image_set: ImageSet) -> tuple[pycolmap.Reconstruction, dict[str, Any]]:
    """A copy of a model of pinhole cameras, adjusted by corners that are found along the hull and by outlines; its points are the corners.

    Returns:
        The copy, and figures: the numbers of `tracks` and of their `observations`; `miss_px` and `error_px`, by how much rims and tracks
        missed in the mean before and after the last round, px per 1000 px of the image. Where fewer than `LEAST_ALIGNED` corners are found,
        the model as it was.
    """
    greys = {path.name: cv2.cvtColor(read_image(path), cv2.COLOR_RGB2GRAY) for path in image_set.images}
    figures: dict[str, Any] = {}
    for play_px in PLAY_PX:
        cameras, masks = undistort_masks(model, image_set)
        tracks = match_along_hull(cameras, masks, [greys[camera.name] for camera in cameras], play_px)
        figures |= {"tracks": tracks.count, "observations": len(tracks.view)}
        if tracks.count < LEAST_ALIGNED:
            break
        adjusted = adjust_model_by_masks(replace_tracks(model, cameras, tracks), cameras, masks, TrackKind.GUIDED, image_set.masks_found)
        model = adjusted.model
        figures |= {"miss_px": list(adjusted.missed_px), "error_px": [round(error_px, 3) for error_px in adjusted.error_px]}
    if "miss_px" not in figures:
        return model, figures
    largest_px = max(max(camera.width, camera.height) for camera in model.cameras.values())
    pycolmap.ObservationManager(model).filter_all_points3D(MOST_ERROR_PX * largest_px / REFERENCE_PX, LEAST_ANGLE_DEG)
    model.update_point_3d_errors()
    model.extract_colors_for_all_images(image_set.images[0].parent, 1)
    return model, figures
