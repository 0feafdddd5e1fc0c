"""What is compared with the reference of SAM-6D: sizes of small networks, their parameters, and inputs of every part."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from helpers.seeded import seeded_state, seeded_tensor
from zeroshop_steps.networks.sam6d.settings import IMAGE_PX, Sam6dSettings

REGIONS, OBJECTS, VIEWS, PATCHES, CHANNELS, POINTS = 6, 3, 7, 16, 12, 50
SIZE_PX = (64, 48)
"""(width, height) of the image in which regions are scored."""


@dataclass(frozen=True)
class RegionCase:
    """Descriptors of regions and views as a describer gives them, and where the regions are.

    Attributes:
        wholes, patches: of the regions, (N, D) and (N, P, D); unit vectors, 0 outside the mask.
        view_wholes, view_patches: of the objects' views, (O, V, D) and (O, V, P, D).
        rotations: (V, 3, 3) camera_from_model.
        points_m: (O, M, 3).
        masks: (N, height, width) bool rectangles.
        depth_mm: (height, width).
        intrinsics: (3, 3).
    """

    wholes: np.ndarray
    patches: np.ndarray
    view_wholes: np.ndarray
    view_patches: np.ndarray
    rotations: np.ndarray
    points_m: np.ndarray
    masks: np.ndarray
    depth_mm: np.ndarray
    intrinsics: np.ndarray

    @property
    def boxes(self) -> np.ndarray:
        """(N, 4) left, top, right, bottom of the masks."""
        places = [np.nonzero(mask) for mask in self.masks]
        return np.array([(columns.min(), rows.min(), columns.max(), rows.max()) for rows, columns in places])


def region_case() -> RegionCase:
    """Regions that resemble views more or less, in the middle of an image."""
    views = _unit(np.abs(seeded_tensor("views", (OBJECTS, VIEWS, CHANNELS)).numpy()))
    view_patches = _unit(seeded_tensor("view patches", (OBJECTS, VIEWS, PATCHES, CHANNELS)).numpy())
    view_patches[:, :, ::5] = 0
    wholes = _unit(np.abs(seeded_tensor("wholes", (REGIONS, CHANNELS)).numpy()))
    patches = _unit(seeded_tensor("patches", (REGIONS, PATCHES, CHANNELS)).numpy())
    patches[:, ::3] = 0
    rotations = np.linalg.qr(seeded_tensor("rotations", (VIEWS, 3, 3)).double().numpy())[0]
    width, height = SIZE_PX
    masks = np.zeros((REGIONS, height, width), bool)
    for index in range(REGIONS):
        masks[index, 12 + index : 30 + index, 20 - index : 44 + index] = True
    depth_mm = 600 + 20 * seeded_tensor("depth", (height, width)).numpy()
    depth_mm[::7] = 0
    intrinsics = np.array([[80.0, 0, 31.3], [0, 82.0, 22.7], [0, 0, 1]])
    points = 0.06 * seeded_tensor("points", (OBJECTS, POINTS, 3)).numpy()
    return RegionCase(wholes, patches, views, view_patches, rotations, points, masks, depth_mm, intrinsics)


SMALL = Sam6dSettings(
    vision_channels=24, vision_depth=8, vision_heads=2, features=16, channels=32, blocks=2, sparse_points=20, dense_points=96,
    hypotheses=60, kept_hypotheses=10,
)  # fmt: skip
FULL = Sam6dSettings()
WHOLE = ("rotations", "places", "scores", "coarse_rotations", "coarse_places", "coarse_logits", "fine_logits")
"""What the whole network answers."""


def parameters(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, torch.Tensor]:
    """Random parameters by the names of the checkpoint; variances are positive, and what is no parameter is left out."""
    state = seeded_state({name: shape for name, shape in shapes.items() if not name.endswith(("div_term", "num_batches_tracked"))})
    return {name: tensor.abs() + 0.5 if name.endswith("running_var") else tensor for name, tensor in state.items()}


def pose_inputs(settings: Sam6dSettings, batch: int = 2) -> dict[str, torch.Tensor]:
    """A crop of noise, and points on an ellipsoid of which the image shows some, turned and moved."""

    def ellipsoid(name: str, count: int) -> torch.Tensor:
        points = torch.nn.functional.normalize(seeded_tensor(name, (batch, count, 3)), dim=2)
        return points * torch.tensor([0.09, 0.06, 0.04])

    count, turn = settings.dense_points, torch.linalg.qr(seeded_tensor("turn", (batch, 3, 3)))[0]
    seen = ellipsoid("seen", count) @ turn.transpose(1, 2) + torch.tensor([0.05, -0.02, 0.8])
    return {
        "crop": seeded_tensor("crop", (batch, 3, IMAGE_PX, IMAGE_PX)),
        "chosen": (seeded_tensor("chosen", (batch, count)).abs() * 1e6).long() % IMAGE_PX**2,
        "points": seen,
        "known_points": ellipsoid("known", count),
        "known_features": seeded_tensor("features", (batch, count, settings.features)),
        "model": ellipsoid("model", 64),
        "draws": torch.special.ndtr(seeded_tensor("draws", (batch, 3 * settings.hypotheses))),
    }


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
