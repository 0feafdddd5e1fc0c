"""The sizes of the networks; those of TRELLIS-image-large by default."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class FlowSettings:
    """Sizes of a flow transformer.

    Attributes:
        resolution: voxels along an edge of its grid.
        channels: of a voxel, in and out.
        width: of a token; blocks and heads of the transformer.
        condition_width: of an image token.
        io_channels: of the voxels before they are pooled two by two into tokens; None where each voxel is a token.
    """

    resolution: int = 16
    channels: int = 8
    width: int = 1024
    blocks: int = 24
    heads: int = 16
    condition_width: int = 1024
    io_channels: int | None = None


@dataclass(frozen=True)
class StructureDecoderSettings:
    """Sizes of the decoder of the sparse structure: channels at each resolution, the coarsest first, and latent channels."""

    latent_channels: int = 8
    channels: tuple[int, ...] = (512, 128, 32)


@dataclass(frozen=True)
class MeshDecoderSettings:
    """Sizes of the mesh decoder; `window` is the edge of an attention window in voxels."""

    resolution: int = 64
    latent_channels: int = 8
    width: int = 768
    blocks: int = 12
    heads: int = 12
    window: int = 8


@dataclass(frozen=True)
class SamplerSettings:
    """How a flow is followed from noise to data.

    Attributes:
        steps: of Euler's method.
        guidance: strength of classifier-free guidance (Ho and Salimans 2022).
        interval: times within which there is guidance (Kynkaanniemi et al. 2024); 1 is noise, 0 data.
        rescale: more than 1 spends more of the steps near the noise.
    """

    steps: int = 25
    guidance: float = 5.0
    interval: tuple[float, float] = (0.5, 1.0)
    rescale: float = 3.0


@dataclass(frozen=True)
class TrellisSettings:
    """Sizes of all networks, how they are sampled, and the mean and spread of the latents that they were trained on.

    Attributes:
        image_px: side of the square pictures.
    """

    structure_flow: FlowSettings = FlowSettings()
    structure_decoder: StructureDecoderSettings = StructureDecoderSettings()
    latent_flow: FlowSettings = FlowSettings(resolution=64, io_channels=128)
    mesh_decoder: MeshDecoderSettings = MeshDecoderSettings()
    sampler: SamplerSettings = SamplerSettings()
    image_px: int = 518
    latent_mean: tuple[float, ...] = field(
        default=(-2.1687546, -0.004347046, -0.1335235, -0.08418073, -0.5271207, 0.7238689, -1.141445, 1.2039363)
    )
    latent_std: tuple[float, ...] = field(default=(2.3776507, 2.3863883, 2.124418, 2.1748552, 2.6639447, 2.3711922, 2.6217446, 2.6845231))
