"""The scores of SAM-6D's instance segmentation (Lin et al., CVPR 2024, section 3.1): meaning, appearance and geometry."""

import numpy as np

Box = tuple[int, int, int, int]
"""Left, top, right and bottom in whole pixels."""
VISIBLE_COSINE = 0.5  # of a view's patch with the most similar patch of a region; the region shows patches with more


def compare_views(regions: np.ndarray, views: np.ndarray) -> np.ndarray:
    """(N, V) cosines, 0..1, of (N, D) and (V, D) unit vectors."""
    return np.clip(regions @ views.T, 0.0, 1.0)


def score_appearance(region: np.ndarray, view: np.ndarray) -> float:
    """0..1: the mean cosine of a region's patches with the most similar ones of a view (equation 3).

    Args:
        region: (P, D) unit vectors, 0 for patches outside the mask.
        view: (Q, D), likewise.
    """
    likeness = (region @ view.T).max(1)
    shown = np.count_nonzero(region.any(1))
    return float(np.clip(likeness.sum() / max(shown, 1), 0.0, 1.0))


def measure_visible_ratio(region: np.ndarray, view: np.ndarray) -> float:
    """0..1: the share of a view's patches that a region shows (equation 5); arguments as in `score_appearance`."""
    likeness = (region @ view.T).max(0)  # 0 for patches outside the view's mask
    return float((likeness > VISIBLE_COSINE).sum() / max(np.count_nonzero(likeness), 1))


def project_box(points_mm: np.ndarray, rotation: np.ndarray, place_mm: np.ndarray, intrinsics: np.ndarray, size_px: tuple[int, int]) -> Box:
    """The box around a model that stands at a place, within the image.

    Args:
        points_mm: (N, 3) on the model, about its middle.
        rotation: (3, 3) camera_from_model.
        place_mm: (3,) of its middle, in front of the camera.
        intrinsics: (3, 3) BOP's K.
        size_px: (width, height) of the image.
    """
    projected = (points_mm @ rotation.T + place_mm) @ intrinsics.T
    pixels = (projected[:, :2] / projected[:, 2:]).astype(int).clip(0, np.array(size_px) - 1)
    (left, top), (right, bottom) = pixels.min(0).tolist(), pixels.max(0).tolist()
    return left, top, right, bottom


def overlap_boxes(one: Box, other: Box) -> float:
    """Intersection over union of two boxes.

    In the published code, one region whose boxes do not meet sets the overlap of all regions of the image to 0; here it sets its own.
    """
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    if width <= 0 or height <= 0:
        return 0.0
    areas = [(box[2] - box[0]) * (box[3] - box[1]) for box in (one, other)]
    return width * height / (sum(areas) - width * height)


def combine_scores(meaning: float, appearance: float, geometry: float, visible_ratio: float) -> float:
    """The score of a detection (equation 6): geometry counts as far as the object is visible."""
    return (meaning + appearance + geometry * visible_ratio) / (2.0 + visible_ratio)
