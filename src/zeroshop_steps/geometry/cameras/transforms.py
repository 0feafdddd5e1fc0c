"""Points and cameras under (4, 4) transforms, and cameras of a smaller image or of a part of one."""

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera, make_transform

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""(4, 4) from a camera that looks along -z with y up to one that looks along z with y down; its own inverse."""
CROP_MARGIN = 1.15
"""Side of a square crop, in longer sides of the mask's box: about 7 % of background on each side."""


def transform_points(points: np.ndarray, target_from_source: np.ndarray) -> np.ndarray:
    """(N, 3) points after a (4, 4) rigid transform or similarity."""
    return points @ target_from_source[:3, :3].T + target_from_source[:3, 3]


def make_unit(vectors: np.ndarray) -> np.ndarray:
    """(..., D) vectors of length 1; of length 0 where they have none."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def make_cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """(N, 3, 3) matrices that multiply as the cross product with each of (N, 3) vectors from the left."""
    return np.cross(np.eye(3), vectors[:, None])


def compute_scale(similarity: np.ndarray) -> float:
    """The scale factor of a (4, 4) similarity: the cube root of its determinant."""
    return float(np.cbrt(np.linalg.det(similarity[:3, :3])))


def move_similarity(start: np.ndarray, step: np.ndarray, centre: np.ndarray, size: float) -> np.ndarray:
    """The (4, 4) similarity `start` after a (7,) step: turned (3) and scaled (1, a logarithm) about a centre, shifted (3) in sizes."""
    turn = np.exp(step[3]) * Rotation.from_rotvec(step[:3]).as_matrix()
    moved = make_transform(turn, centre - turn @ centre + step[4:] * size)
    return moved @ start


def transform_camera(camera: Camera, target_from_world: np.ndarray) -> Camera:
    """The camera that sees a model moved by the (4, 4) similarity `target_from_world` as `camera` sees it unmoved.

    Depths scale with the similarity.
    """
    linear = target_from_world[:3, :3]
    rotation = camera.camera_from_world[:3, :3] @ (linear / compute_scale(target_from_world)).T
    centre = linear @ camera.centre_in_world + target_from_world[:3, 3]
    camera_from_target = make_transform(rotation, -rotation @ centre)
    return Camera(camera.name, camera.width_px, camera.height_px, camera.intrinsics, camera_from_target)


def shrink_camera(camera: Camera, longest_px: int) -> Camera:
    """The camera of the image shrunk until its longer side has at most `longest_px` pixels."""
    scale = min(1.0, longest_px / max(camera.width_px, camera.height_px))
    return camera.resized(max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale)))


def crop_to_mask(camera: Camera, mask: np.ndarray) -> tuple[Camera, int, int]:
    """A square crop around a (height, width) bool mask; around the whole image where the mask is empty.

    Returns:
        camera: of the crop.
        left, top: the crop's first pixel in the image; it may lie outside.
    """
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if len(rows) == 0:
        rows, columns = np.arange(mask.shape[0]), np.arange(mask.shape[1])
    side = int(np.ceil(CROP_MARGIN * max(np.ptp(rows), np.ptp(columns)))) + 1
    left, top = int(columns[0] + columns[-1] - side) // 2, int(rows[0] + rows[-1] - side) // 2
    return camera.cropped(left, top, side, side), left, top


def measure_turn_deg(one: np.ndarray, other: np.ndarray) -> float:
    """Angle between two (3, 3) rotations, in degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(other @ one.T) - 1) / 2, -1, 1))))
