"""The whole network: features of pixels, coarse and fine matching of points, and the pose."""

from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.layers import NORM_EPSILON, Block, Patches
from zeroshop_steps.networks.sam6d.embedding import PairEmbedding
from zeroshop_steps.networks.sam6d.point_matching import CoarseMatching, FineMatching, SparseCloud
from zeroshop_steps.networks.sam6d.points import sample_farthest, take
from zeroshop_steps.networks.sam6d.pose_solver import find_coarse_pose, find_fine_pose
from zeroshop_steps.networks.sam6d.settings import GRID, IMAGE_PX, PATCH_PX, Sam6dSettings
from zeroshop_steps.networks.weights import load_strictly, read_own_sizes

FINER = 4  # each patch gives FINER x FINER features, which are then interpolated
NAME = "sam-6d-pem-base.pth"
SIZES = ".json"
"""Suffix of the file beside weights that tells the sizes of a network of one's own."""
UNUSED = "feature_extraction.rgb_net.vit.head."  # of the classes of images that the vision transformer was made for


class VisionTransformer(nn.Module):
    """The patch tokens after each quarter of the blocks."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        channels = settings.vision_channels
        self.patch_embed = Patches(PATCH_PX, channels)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, channels))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + GRID**2, channels))
        self.blocks = nn.ModuleList(
            Block(channels, settings.vision_heads, scaled=False, eps=NORM_EPSILON) for _ in range(settings.vision_depth)
        )
        self.norm = nn.LayerNorm(channels, eps=NORM_EPSILON)

    def forward(self, images: Tensor) -> list[Tensor]:
        """(B, 3, IMAGE_PX, IMAGE_PX) to four times (B, GRID^2, C), the first layer first."""
        tokens = torch.cat([self.cls_token.expand(len(images), -1, -1), self.patch_embed(images)], 1) + self.pos_embed
        quarter, layers = len(self.blocks) // 4, []
        for index, block in enumerate(self.blocks):
            tokens = block(tokens)
            if (len(self.blocks) - 1 - index) % quarter == 0 and len(self.blocks) - 1 - index < 4 * quarter:
                layers.append(self.norm(tokens)[:, 1:])
        return layers


class PixelFeatures(nn.Module):
    """A feature of each pixel."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        self.vit = VisionTransformer(settings)
        self.output_upscaling = nn.Linear(4 * settings.vision_channels, FINER**2 * settings.features)

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, IMAGE_PX, IMAGE_PX) normalised crops to (B, C, IMAGE_PX, IMAGE_PX)."""
        cells = self.output_upscaling(torch.cat(self.vit(images), 2)).unflatten(2, (FINER, FINER, -1)).unflatten(1, (GRID, GRID))
        finer = cells.permute(0, 5, 1, 3, 2, 4).reshape(len(images), -1, GRID * FINER, GRID * FINER)
        return F.interpolate(finer, (IMAGE_PX, IMAGE_PX), mode="bilinear", align_corners=False)


class FeatureExtraction(nn.Module):
    """Features of chosen pixels; the checkpoint has the network of pixels below `rgb_net`."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        self.rgb_net = PixelFeatures(settings)

    def forward(self, images: Tensor, chosen: Tensor) -> Tensor:
        """(B, 3, IMAGE_PX, IMAGE_PX) crops and (B, N) indices of their pixels, row by row, to (B, N, C)."""
        features = self.rgb_net(images).flatten(2)
        return features.gather(2, chosen[:, None].expand(-1, features.shape[1], -1)).transpose(1, 2)


@dataclass(frozen=True)
class KnownObject:
    """What is known of B objects from their views.

    Attributes:
        points: (B, M, 3) metres, in the frame of the model.
        features: (B, M, C).
        model: (B, P, 3) metres, evenly on the surface.
    """

    points: Tensor
    features: Tensor
    model: Tensor


@dataclass(frozen=True)
class PosePrediction:
    """Poses of B objects.

    Attributes:
        rotations: (B, 3, 3) camera_from_model.
        places: (B, 3) metres.
        scores: (B,), 0..1.
    """

    rotations: Tensor
    places: Tensor
    scores: Tensor


class Sam6dPem(nn.Module):
    """SAM-6D's pose estimation."""

    def __init__(self, settings: Sam6dSettings | None = None) -> None:
        super().__init__()
        self.settings = settings = settings or Sam6dSettings()
        self.feature_extraction = FeatureExtraction(settings)
        self.geo_embedding = PairEmbedding(settings.channels, settings.neighbours)
        self.coarse_point_matching = CoarseMatching(settings)
        self.fine_point_matching = FineMatching(settings)

    def describe(self, crops: Tensor, chosen: Tensor) -> Tensor:
        """(B, 3, IMAGE_PX, IMAGE_PX) normalised crops and (B, N) indices of their pixels, row by row, to (B, N, C) features."""
        return self.feature_extraction(crops, chosen)

    def match_coarse(self, seen: SparseCloud, known: SparseCloud) -> Tensor:
        """(B, 1 + S, 1 + S) logits of pairs of sparse points."""
        return self.coarse_point_matching(seen, known)

    def match_fine(
        self,
        seen_points: Tensor,
        seen_features: Tensor,
        seen: SparseCloud,
        known_points: Tensor,
        known_features: Tensor,
        known: SparseCloud,
    ) -> Tensor:
        """(B, 1 + N, 1 + M) logits of pairs of all points, which are in the frame of the model."""
        return self.fine_point_matching(seen_points, seen_features, seen, known_points, known_features, known)

    def forward(self, points: Tensor, features: Tensor, known: KnownObject, draws: Tensor) -> PosePrediction:
        """Estimate poses, in single precision whatever the rest does: half of it is too coarse for points.

        Args:
            points: (B, N, 3) of the image, metres, in the frame of the camera.
            features: (B, N, C).
            known: the objects.
            draws: (B, 3 H) random numbers, 0..1, for H hypotheses.
        """
        with torch.autocast(points.device.type, enabled=False):
            return self._estimate(points, features.float(), known, draws)

    def _estimate(self, points: Tensor, features: Tensor, known: KnownObject, draws: Tensor) -> PosePrediction:
        radius = known.points.norm(dim=2).amax(1)[:, None, None] + 1e-6
        points, known_points, model = points / radius, known.points / radius, known.model / radius
        seen, object_cloud = self._thin_out(points, features), self._thin_out(known_points, known.features)
        logits = self.match_coarse(seen, object_cloud)
        rotations, places = find_coarse_pose(logits, seen.points, object_cloud.points, model, draws, self.settings.kept_hypotheses)
        near = (points - places[:, None]) @ rotations
        logits = self.match_fine(near, features, seen, known_points, known.features, object_cloud)
        rotations, places, scores = find_fine_pose(logits, points, known_points, model)
        return PosePrediction(rotations, places * radius[:, 0], scores)

    def _thin_out(self, points: Tensor, features: Tensor) -> SparseCloud:
        indices = sample_farthest(points, self.settings.sparse_points)
        sparse = take(points, indices)
        # The point that stands for none, in radii of the object.
        none = torch.full_like(sparse[:, :1], 100.0)
        return SparseCloud(indices, sparse, take(features, indices), self.geo_embedding(torch.cat([none, sparse], 1)))


def load_sam6d_pem(path: Path) -> Sam6dPem:
    """The network with the weights in `path`.

    A JSON file of the same stem beside it, if there is one, says the sizes of a network of one's own.

    Raises:
        StepError: the weights are damaged or of another network.
    """
    path = Path(path)
    with torch.device("meta"):
        network = Sam6dPem(read_own_sizes(path.with_suffix(SIZES), Sam6dSettings))
    load_strictly(network, path, _rename)
    return network.eval().requires_grad_(False)


def _rename(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """The published names without what training on several GPUs puts before them, and without the unused head."""
    prefix = "module." if all(name.startswith("module.") for name in state) else ""
    named = {name.removeprefix(prefix): tensor for name, tensor in state.items()}
    return {name: tensor for name, tensor in named.items() if not name.startswith(UNUSED)}
