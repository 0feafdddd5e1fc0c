"""Masks, boxes and visibility of objects in a rendered image, as in BOP's mask/, mask_visib/ and scene_gt_info.json."""

from dataclasses import dataclass, replace

import numpy as np

from zeroshop_steps.bop.scoring.depth_render import DepthRenderer

SAME_SURFACE_MM = 0.5  # of depth: an object this far behind the rendered scene is visible; the two renderings differ by rounding only


@dataclass(frozen=True)
class Annotation:
    """One object in an image.

    Attributes:
        silhouette: (height, width) bool, all of its pixels, hidden or not.
        visible: (height, width) bool, those that nothing hides.
        info: its entry of scene_gt_info.json. px_count_all and bbox_obj include pixels beyond the image's border.
    """

    silhouette: np.ndarray
    visible: np.ndarray
    info: dict

    def seen_as(self, visible: np.ndarray) -> "Annotation":
        """The same with (height, width) bool visible pixels that are known otherwise, as from a photo's mask."""
        return replace(self, visible=visible, info=self.info | _describe_visible(visible, self.info["px_count_all"]))


def annotate(
    renderer: DepthRenderer,
    camera_from_model: np.ndarray,
    intrinsics: np.ndarray,
    scene_mm: np.ndarray,
    measured_mm: np.ndarray,
    delta_mm: float = SAME_SURFACE_MM,
) -> Annotation:
    """Annotate one object.

    Args:
        renderer: of its model.
        camera_from_model: (4, 4) its pose, mm.
        intrinsics: (3, 3) BOP's K.
        scene_mm: (height, width) depth of the whole scene, exact or measured, 0 where nothing is known to be.
        measured_mm: (height, width) depth of the sensor, 0 where it gives none.
        delta_mm: how far behind `scene_mm` the object is still visible.
    """
    height, width = scene_mm.shape
    shifted = intrinsics + np.array([[0, 0, width], [0, 0, height], [0, 0, 0]])
    wide = renderer.render(camera_from_model, shifted, 3 * width, 3 * height).image(3 * width, 3 * height)
    inside = wide[height : 2 * height, width : 2 * width]
    silhouette = inside > 0
    visible = silhouette & ((scene_mm == 0) | (inside <= scene_mm + delta_mm))
    count = int((wide > 0).sum())
    x, y, box_width, box_height = _bounding_box(wide > 0)
    info = {
        "bbox_obj": [x - width, y - height, box_width, box_height] if visible.any() else [-1, -1, -1, -1],
        "px_count_all": count,
        "px_count_valid": int((measured_mm[silhouette] > 0).sum()),
        **_describe_visible(visible, count),
    }
    return Annotation(silhouette, visible, info)


def _describe_visible(visible: np.ndarray, count: int) -> dict:
    """What scene_gt_info.json says of (height, width) bool visible pixels, of so many in all."""
    seen = int(visible.sum())
    return {"bbox_visib": _bounding_box(visible), "px_count_visib": seen, "visib_fract": min(seen / count, 1.0) if count else 0.0}


def _bounding_box(mask: np.ndarray) -> list[int]:
    """[x, y, width, height] as BOP defines it: width and height are last minus first pixel; -1 for an empty mask."""
    if not mask.any():
        return [-1, -1, -1, -1]
    columns, rows = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
    return [int(columns[0]), int(rows[0]), int(columns[-1] - columns[0]), int(rows[-1] - rows[0])]
