"""Settings of the training of surfels. This module does not import PyTorch, so that `--help` answers at once."""

from dataclasses import dataclass

from zeroshop_steps.surface.training.training_options import TrainingSettings

OPTIONS = {
    "lambda_dssim": "share of structural dissimilarity in the photometric loss; the rest is L1",
    "lambda_mask": "weight of the difference between opacity and mask",
    "lambda_normal": "weight of normal consistency with the rendered depth",
    "lambda_distortion": "weight of depth distortion: surfels on a ray lie close together",
    "lambda_depth": "weight of the depths that are known before training",
    "coarse_share": "share of the iterations on images of half the width",
    "normal_from_share": "share of the iterations before normals count",
    "densify_from_share": "share of the iterations before surfels are cloned, split and dropped",
    "densify_until_share": "share of the iterations after which they no longer are",
    "densify_every": "iterations from one densification to the next",
    "densify_gradient": "mean screen-space gradient from which a surfel is cloned or split",
    "opacity_reset_share": "share of the iterations from one lowering of all opacities to the next",
    "opacity_min": "surfels fainter than this are dropped",
    "count_max": "no more surfels than this",
}
"""Options of the command line, by their names in SurfelSettings."""


@dataclass(frozen=True)
class SurfelSettings(TrainingSettings):
    """What a run depends on besides its images. Settings ending in `_share` are fractions of `iterations`.

    The paper trains whole scenes for 30,000 iterations. These values were tuned on renderings of demo and YCB-V objects: 800
    iterations explain about twenty views of one object.

    Attributes:
        lambda_...: weights of the terms of the loss, as `OPTIONS` explains them.
        densify_..., opacity_..., count_max: when surfels are cloned, split and dropped, as `OPTIONS` explains.
        densify_gradient: in loss per pixel of shift, summed over the image's pixels (`densify_and_prune`). The paper's 0.0002 is in
            loss per half image width, averaged over the pixels: with images of 400 x 300 pixels, 0.0002 * 2 / 400 * (400 * 300) = 0.12.
    """

    iterations: int = 800
    sh_degree: int = 2
    seed: int = 0
    initialization: str = "stereo"
    lambda_dssim: float = 0.2
    lambda_mask: float = 0.5
    lambda_normal: float = 0.05
    lambda_distortion: float = 0.0
    normal_from_share: float = 0.25
    densify_from_share: float = 0.05
    densify_until_share: float = 0.6
    densify_every: int = 100
    densify_gradient: float = 0.12
    opacity_reset_share: float = 0.2
    opacity_min: float = 0.05
    count_max: int = 40_000
    device: str = "cpu"
    coarse_share: float = 0.5
    lambda_depth: float = 5.0
