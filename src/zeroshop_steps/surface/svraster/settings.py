"""Settings of the training of sparse voxels. This module does not import PyTorch, so that `--help` answers at once."""

from dataclasses import dataclass

from zeroshop_steps.surface.training.training_options import TrainingSettings

OPTIONS = {
    "lambda_dssim": "share of structural dissimilarity in the photometric loss; the rest is L1",
    "lambda_mask": "weight of the difference between opacity and mask",
    "lambda_transmittance": "weight of transmittance concentration: a pixel is full or empty",
    "lambda_color": "weight of colour concentration: everything on a ray has the photo's colour",
    "lambda_ascending": "weight of the ascending loss: density rises along the ray",
    "lambda_normal": "weight of normal consistency with the median depth",
    "lambda_depth": "weight of the depths that are known before training",
    "coarse_share": "share of the iterations on images of half the width",
    "normal_from_share": "share of the iterations before normals count",
    "adapt_shares": "after which shares of the iterations voxels are pruned and subdivided",
    "weight_min": "voxels whose largest blending weight is smaller in all views are dropped",
    "level_start": "octree level of the coarsest leaves at first",
    "level_max": "octree level of the finest leaves ever",
    "count_max": "no more leaves than this",
}
"""Options of the command line, by their names in VoxelSettings."""


@dataclass(frozen=True)
class VoxelSettings(TrainingSettings):
    """What a run depends on besides its images. Settings ending in `_share` are fractions of `iterations`.

    The defaults were tuned on the demo mustard bottle.

    Attributes:
        lambda_...: weights of the terms of the loss, as `OPTIONS` explains them.
        adapt_shares, weight_min, level_..., count_max: when and how voxels are pruned and subdivided, as `OPTIONS` explains.
    """

    iterations: int = 400
    sh_degree: int = 1
    seed: int = 0
    initialization: str = "stereo"
    lambda_dssim: float = 0.02
    lambda_mask: float = 0.5
    lambda_transmittance: float = 0.1
    lambda_color: float = 0.01
    lambda_ascending: float = 0.01
    lambda_normal: float = 0.2
    lambda_depth: float = 5.0
    normal_from_share: float = 0.25
    coarse_share: float = 0.5
    adapt_shares: tuple[float, ...] = (0.1, 0.5, 0.65)
    weight_min: float = 0.005
    level_start: int = 6
    level_max: int = 8
    count_max: int = 70_000
    device: str = "cpu"
