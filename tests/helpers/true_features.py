"""Features that stand in for a network's: random functions of the true place on the object, with noise. Near places have like features."""

import numpy as np

from zeroshop_steps.bop.scene import Frame
from zeroshop_steps.detect.cnos.crops import SIDE_PX, cover_patches, cut_square
from zeroshop_steps.detect.templates import Templates
from zeroshop_steps.geometry.transforms import transform_points

CHANNELS, GRID = 256, 16
SAME_PLACE_MM = 12.0  # places that are farther apart have features of little likeness (their cosine is below 0.6)
SAME_TURN = 1.0  # likewise of rotations, by the entries of their matrices: about 40 degrees


def random_features(values: np.ndarray, name: int, scale: float) -> np.ndarray:
    """(N, CHANNELS) of (N, K) values: random cosines, whose products are about exp(-distance^2 / (2 scale^2)) (Rahimi and Recht 2007)."""
    rng = np.random.default_rng(name)
    waves, phases = rng.normal(0, 1 / scale, (values.shape[1], CHANNELS)), rng.uniform(0, 2 * np.pi, CHANNELS)
    return np.cos(values @ waves + phases) * np.sqrt(2 / CHANNELS)


def places_on_objects(frame: Frame) -> list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Of each visible instance: its object, its (height, width) mask, its pose, and where on the model, mm, each pixel lies."""
    depth_mm = frame.depth_mm()
    rows, columns = np.indices(depth_mm.shape)
    points = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(frame.intrinsics).T * depth_mm[..., None]
    found = []
    for index, one in enumerate(frame.instances):
        mask = frame.mask(index)
        if mask.any():
            found.append((one.object_id, mask, one.camera_from_model, transform_points(points, np.linalg.inv(one.camera_from_model))))
    return found


class TrueDescriber:
    """Describes crops by what is truly there, as `CropDescriber` does by DINOv2; knows the pictures that it was told of."""

    def __init__(self, noise: float, seed: int = 0) -> None:
        self._noise, self._rng = noise, np.random.default_rng(seed)
        self._known: dict[bytes, list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]] = {}

    def learn_frame(self, photo: np.ndarray, frame: Frame) -> None:
        """Know what a photo shows."""
        self._known[photo.tobytes()] = places_on_objects(frame)

    def learn_views(self, number: int, views: Templates) -> None:
        """Know what the views of a model show."""
        rows, columns = np.indices(views.depths_mm.shape[1:]) + 0.5
        rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(views.intrinsics).T
        for color, depth_mm, pose in zip(views.colors, views.depths_mm, views.camera_from_model, strict=True):
            places = transform_points(rays * depth_mm[..., None], np.linalg.inv(pose))
            self._known[color.tobytes()] = [(number, depth_mm > 0, pose, places)]

    def describe_patches(self, regions: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        """As CropDescriber.describe_patches."""
        wholes, patches = zip(*(self._describe(image, mask) for image, mask in regions), strict=True)
        return np.stack(wholes), np.stack(patches)

    def _describe(self, image: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        number, there, pose, places = max(self._known[image.tobytes()], key=lambda one: int((one[1] & mask).sum()))
        whole = self._noisy(random_features(pose[:3, :3].reshape(1, 9), number, SAME_TURN))[0]
        filled = np.where((there & mask)[..., None], places, 0).astype(np.float32)
        step = SIDE_PX // GRID
        sums = cut_square(filled, mask).reshape(GRID, step, GRID, step, 3).sum((1, 3)).reshape(-1, 3)
        counts = cut_square((there & mask).astype(np.float32), mask).reshape(GRID, step, GRID, step).sum((1, 3)).reshape(-1, 1)
        features = self._noisy(random_features(sums / np.maximum(counts, 1e-6), number, SAME_PLACE_MM))
        covered = cover_patches(cut_square(mask.astype(np.uint8) * 255, mask)[None], GRID**2)[0]
        return whole, features * covered[:, None]

    def _noisy(self, features: np.ndarray) -> np.ndarray:
        """Unit vectors with noise of so many times their length."""
        noisy = features + self._rng.normal(0, self._noise / np.sqrt(CHANNELS), features.shape)
        return noisy / np.linalg.norm(noisy, axis=1, keepdims=True)
