"""Features that stand in for a network's: random functions of the true place on the object, with noise. Near places have like features."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.detect.cnos.crops import SIDE_PX, cover_patches, cut_square
from zeroshop_steps.detect.templates import Templates
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.networks.imagenet import DEVIATION, MEAN
from zeroshop_steps.networks.sam6d.model import Sam6dPem
from zeroshop_steps.networks.sam6d.point_matching import SparseCloud
from zeroshop_steps.networks.sam6d.settings import Sam6dSettings

CHANNELS, GRID = 256, 16
SAME_PLACE_MM = 12.0  # places that are farther apart have features of little likeness (their cosine is below 0.6)
SAME_PLACE_DIAMETERS = 0.04  # likewise, where points are matched
LEAST_LIKENESS = 0.5  # cosine of points that belong together
DARKEST, OUTLINE_PX = 0.1, 4  # sum of the colours of black, 0..3; distance of mixed colours from it, in the crop
SHARP = 0.02  # temperature of their likenesses; at a higher one, pairs are means over several places, which shifts poses
SAME_SIDE = 0.6  # likewise of unit vectors from the object to the camera: about 35 degrees


def random_features(values: np.ndarray, name: int, scale: float) -> np.ndarray:
    """(N, CHANNELS) of (N, K) values: random cosines, whose products are about exp(-distance^2 / (2 scale^2)) (Rahimi and Recht 2007)."""
    rng = np.random.default_rng(name)
    waves, phases = rng.normal(0, 1 / scale, (values.shape[1], CHANNELS)), rng.uniform(0, 2 * np.pi, CHANNELS)
    return np.cos(values @ waves + phases) * np.sqrt(2 / CHANNELS)


def places_on_objects(frame: Frame, models: Mapping[int, ObjectModel]) -> list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Of each visible instance: its object, its (height, width) mask, its pose, and which place on the model, mm, each pixel shows."""
    found = []
    for index, one in enumerate(frame.instances):
        mask = frame.mask(index)
        if mask.any():
            height, width = mask.shape
            renderer = DepthRenderer(models[one.object_id].mesh)
            depth_mm = renderer.render(one.camera_from_model, frame.intrinsics, width, height).image(width, height)
            rows, columns = np.indices(mask.shape)
            points = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(frame.intrinsics).T * depth_mm[..., None]
            found.append(
                (
                    one.object_id,
                    mask & (depth_mm > 0),
                    one.camera_from_model,
                    transform_points(points, np.linalg.inv(one.camera_from_model)),
                )
            )
    return found


class TrueDescriber:
    """Describes crops by what is truly there, as `CropDescriber` does by DINOv2; knows the pictures that it was told of."""

    def __init__(self, models: Mapping[int, ObjectModel], noise: float, seed: int = 0) -> None:
        self._models, self._noise, self._rng = models, noise, np.random.default_rng(seed)
        self._known: dict[bytes, list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]] = {}

    def learn_frame(self, photo: np.ndarray, frame: Frame) -> None:
        """Know what a photo shows."""
        self._known[photo.tobytes()] = places_on_objects(frame, self._models)

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
        whole = self._noisy(random_features(pose[2:3, :3], number, SAME_SIDE))[0]
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


class TrueNetwork(Sam6dPem):
    """SAM-6D's pose estimation whose pixels have features of the true places on the object, and whose points are matched by these.

    The places are painted: red, green and blue are x, y and z in the model's box. So they take the way of real colours, through masks,
    crops and pixels that are drawn from them.
    """

    def __init__(self, box_mm: np.ndarray, noise: float, seed: int = 0) -> None:
        """`box_mm`: (2, 3) corners of the model's box."""
        small = {"dense_points": 512, "sparse_points": 96, "hypotheses": 1000, "kept_hypotheses": 50}
        super().__init__(Sam6dSettings(vision_channels=12, vision_depth=4, features=CHANNELS, channels=8, blocks=0, **small))
        self._box_mm, self._noise, self._rng = box_mm, noise, np.random.default_rng(seed)
        self._same_place_mm = SAME_PLACE_DIAMETERS * float(np.linalg.norm(box_mm[1] - box_mm[0]))

    def paint(self, places_mm: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """(height, width, 3) uint8 of (height, width, 3) places; black outside the mask."""
        shares = (places_mm - self._box_mm[0]) / (self._box_mm[1] - self._box_mm[0])
        return np.where(mask[..., None], np.rint(55 + 200 * np.clip(shares, 0, 1)), 0).astype(np.uint8)

    def paint_views(self, views: Templates) -> Templates:
        """The views of the model, painted."""
        rows, columns = np.indices(views.depths_mm.shape[1:]) + 0.5
        rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(views.intrinsics).T
        places = [
            transform_points(rays * depth_mm[..., None], np.linalg.inv(pose))
            for depth_mm, pose in zip(views.depths_mm, views.camera_from_model, strict=True)
        ]
        return replace(views, colors=np.stack([self.paint(one, mask) for one, mask in zip(places, views.masks, strict=True)]))

    def describe(self, crops: torch.Tensor, chosen: torch.Tensor) -> torch.Tensor:
        """Features of painted places; at the outline, where paint is mixed with the black around it, they are noise alone."""
        colors = crops[0].flatten(1)[:, chosen[0]].T.numpy() * DEVIATION + MEAN
        shares = (255 * colors[:, ::-1] - 55) / 200
        features = random_features(self._box_mm[0] + shares * (self._box_mm[1] - self._box_mm[0]), 0, self._same_place_mm)
        black = (crops[0].permute(1, 2, 0) * torch.tensor(DEVIATION, dtype=torch.float64) + torch.tensor(MEAN, dtype=torch.float64)).sum(
            2
        ) < DARKEST
        outline = torch.nn.functional.max_pool2d(black[None, None].float(), 2 * OUTLINE_PX + 1, 1, OUTLINE_PX).flatten()[chosen[0]].bool()
        features[outline.numpy()] = 0
        return torch.from_numpy(features + self._rng.normal(0, self._noise / np.sqrt(CHANNELS), features.shape))[None].float()

    def match_coarse(self, seen: SparseCloud, known: SparseCloud) -> torch.Tensor:
        return self._match(seen.features, known.features)

    def match_fine(
        self, _: torch.Tensor, features: torch.Tensor, __: SparseCloud, ___: torch.Tensor, others: torch.Tensor, ____: SparseCloud
    ) -> torch.Tensor:
        return self._match(features, others)

    @staticmethod
    def _match(features: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
        """Sharp likenesses by the features' cosines; a point whose features are like none by more than a half belongs to none."""
        first, second = (torch.nn.functional.normalize(part, dim=2) for part in (features, others))
        return torch.nn.functional.pad(first @ second.transpose(1, 2), (1, 0, 1, 0), value=LEAST_LIKENESS) / SHARP
