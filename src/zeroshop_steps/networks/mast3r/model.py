"""The whole network: an encoder for each picture, two decoders that look at each other's picture, and two heads each."""

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from zeroshop_steps.networks.layers import NORM_EPSILON, Attention, Block, Mlp, Patches, Rotation
from zeroshop_steps.networks.mast3r.dpt import DensePrediction, decode_points
from zeroshop_steps.networks.weights import load_strictly
from zeroshop_steps.runtime.errors import StepError

PATCH_PX = 16  # of the published network
SIZES = ".json"
"""Suffix of the file beside weights that tells the sizes of a network of one's own."""


class CrossAttention(nn.Module):
    """Attention from one image to the other."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.projq, self.projk, self.projv, self.proj = (nn.Linear(channels, channels) for _ in range(4))

    def forward(self, x: Tensor, other: Tensor, rotation: Rotation, other_rotation: Rotation) -> Tensor:
        query, key, value = (
            project(tokens).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for project, tokens in ((self.projq, x), (self.projk, other), (self.projv, other))
        )
        attended = F.scaled_dot_product_attention(rotation(query), other_rotation(key), value)
        return self.proj(attended.transpose(1, 2).flatten(2))


class DecoderBlock(nn.Module):
    """Self-attention, attention to the other image, and MLP."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.norm1, self.norm2, self.norm3, self.norm_y = (nn.LayerNorm(channels, eps=NORM_EPSILON) for _ in range(4))
        self.attn = Attention(channels, heads)
        self.cross_attn = CrossAttention(channels, heads)
        self.mlp = Mlp(channels, 4 * channels)

    def forward(self, x: Tensor, other: Tensor, rotation: Rotation, other_rotation: Rotation) -> Tensor:
        x = x + self.attn(self.norm1(x), rotation)
        x = x + self.cross_attn(self.norm2(x), self.norm_y(other), rotation, other_rotation)
        return x + self.mlp(self.norm3(x))


@dataclass(frozen=True)
class Mast3rSettings:
    """Sizes of the network; by default those of the published ViT-Large with base decoder."""

    encoder_channels: int = 1024
    encoder_depth: int = 24
    encoder_heads: int = 16
    decoder_channels: int = 768
    decoder_depth: int = 12
    decoder_heads: int = 12
    descriptor_channels: int = 24
    dense_channels: tuple[int, ...] = (96, 192, 384, 768)
    dense_features: int = 256


@dataclass(frozen=True)
class ImagePrediction:
    """What the network says of one picture of a pair; B pairs.

    Attributes:
        points: (B, height, width, 3) metres, in the camera frame (OpenCV axes) of the FIRST picture.
        confidence: (B, height, width) of the points, above 1.
        descriptors: (B, height, width, D) unit vectors.
        descriptor_confidence: (B, height, width), above 0.
    """

    points: Tensor
    confidence: Tensor
    descriptors: Tensor
    descriptor_confidence: Tensor


class Mast3rHead(nn.Module):
    """Points with their confidence by a dense prediction transformer, local features with theirs by an MLP for each patch."""

    def __init__(self, configuration: Mast3rSettings) -> None:
        super().__init__()
        encoder, decoder, depth = configuration.encoder_channels, configuration.decoder_channels, configuration.decoder_depth
        self.layers = (0, depth // 2, depth * 3 // 4, depth)
        tokens = encoder, decoder, decoder, decoder
        self.dpt = DensePrediction(tokens, configuration.dense_channels, configuration.dense_features, out=4)
        both = encoder + decoder
        self.head_local_features = Mlp(both, 4 * both, (configuration.descriptor_channels + 1) * PATCH_PX**2)

    def forward(self, layers: list[Tensor], rows: int, columns: int) -> ImagePrediction:
        """`layers`: the encoder's output and that of each decoder block, (B, rows * columns, C)."""
        dense = self.dpt([layers[index] for index in self.layers], rows, columns).permute(0, 2, 3, 1)
        local = self.head_local_features(torch.cat([layers[0], layers[-1]], dim=-1))
        local = F.pixel_shuffle(local.transpose(1, 2).unflatten(2, (rows, columns)), PATCH_PX).permute(0, 2, 3, 1)
        return ImagePrediction(
            points=decode_points(dense[..., :3]),
            confidence=1.0 + dense[..., 3].exp(),
            descriptors=local[..., :-1] / local[..., :-1].norm(dim=-1, keepdim=True),
            descriptor_confidence=local[..., -1].exp(),
        )


class MASt3R(nn.Module):
    """MASt3R (Leroy et al. 2024, section 3.1 and 3.2) on top of DUSt3R (Wang et al. 2024, section 3.1).

    Pictures are (B, 3, height, width), sides multiples of 16, values from -1 to 1.
    """

    def __init__(self, configuration: Mast3rSettings | None = None) -> None:
        super().__init__()
        self.configuration = configuration = configuration or Mast3rSettings()
        self.patch_embed = Patches(PATCH_PX, configuration.encoder_channels)
        self.enc_blocks = nn.ModuleList(
            Block(configuration.encoder_channels, configuration.encoder_heads, scaled=False, eps=NORM_EPSILON)
            for _ in range(configuration.encoder_depth)
        )
        self.enc_norm = nn.LayerNorm(configuration.encoder_channels, eps=NORM_EPSILON)
        self.decoder_embed = nn.Linear(configuration.encoder_channels, configuration.decoder_channels)
        # Of the training on masked pictures (CroCo v2, section 3.1): nothing reads it, but the checkpoint has it.
        self.mask_token = nn.Parameter(torch.zeros(1, 1, configuration.decoder_channels))
        self.dec_blocks, self.dec_blocks2 = (
            nn.ModuleList(
                DecoderBlock(configuration.decoder_channels, configuration.decoder_heads) for _ in range(configuration.decoder_depth)
            )
            for _ in range(2)
        )
        self.dec_norm = nn.LayerNorm(configuration.decoder_channels, eps=NORM_EPSILON)
        self.downstream_head1, self.downstream_head2 = Mast3rHead(configuration), Mast3rHead(configuration)

    def encode(self, image: Tensor) -> Tensor:
        """(B, 3, height, width) pictures to (B, height / 16 * width / 16, C) tokens."""
        head_dim = self.configuration.encoder_channels // self.configuration.encoder_heads
        rotation = rotate_by_place(count_patches(image), head_dim, image.device)
        tokens = self.patch_embed(image)
        for block in self.enc_blocks:
            tokens = block(tokens, rotation)
        return self.enc_norm(tokens)

    def decode(self, first: Tensor, second: Tensor, first_grid: tuple[int, int], second_grid: tuple[int, int]) -> list[list[Tensor]]:
        """Tokens of both pictures to those of all layers, the encoder's first, for each of them."""
        head_dim = self.configuration.decoder_channels // self.configuration.decoder_heads
        rotations = [rotate_by_place(grid, head_dim, first.device) for grid in (first_grid, second_grid)]
        layers = [[first], [second]]
        tokens = [self.decoder_embed(first), self.decoder_embed(second)]
        for blocks in zip(self.dec_blocks, self.dec_blocks2, strict=True):
            tokens = [blocks[side](tokens[side], tokens[1 - side], rotations[side], rotations[1 - side]) for side in (0, 1)]
            for side in (0, 1):
                layers[side].append(tokens[side])
        for side in (0, 1):
            layers[side][-1] = self.dec_norm(layers[side][-1])
        return layers

    def predict(
        self, first: Tensor, second: Tensor, first_grid: tuple[int, int], second_grid: tuple[int, int]
    ) -> tuple[ImagePrediction, ImagePrediction]:
        """Encoded pictures, (B, rows * columns, C) each with its (rows, columns), to what the network says of both.

        The heads run in single precision whatever the rest does: exponentials of half precision are too coarse for points.
        """
        layers = self.decode(first, second, first_grid, second_grid)
        with torch.autocast(first.device.type, enabled=False):
            return (
                self.downstream_head1([layer.float() for layer in layers[0]], *first_grid),
                self.downstream_head2([layer.float() for layer in layers[1]], *second_grid),
            )

    def forward(self, first: Tensor, second: Tensor) -> tuple[ImagePrediction, ImagePrediction]:
        """A pair of pictures, of equal size or not, to what the network says of both."""
        return self.predict(self.encode(first), self.encode(second), count_patches(first), count_patches(second))


def rotate_by_place(grid: tuple[int, int], head_dim: int, device: torch.device | str = "cpu") -> Rotation:
    """The rotation of the tokens of a grid of (rows, columns), in row-major order."""
    rows, columns = (torch.arange(count, device=device) for count in grid)
    return Rotation.of(torch.cartesian_prod(rows, columns), head_dim)


def count_patches(image: Tensor) -> tuple[int, int]:
    """Rows and columns of the patches of (B, 3, height, width) pictures."""
    return image.shape[2] // PATCH_PX, image.shape[3] // PATCH_PX


def load_mast3r(path: Path) -> MASt3R:
    """The network with the weights in `path`.

    A JSON file of the same stem beside it, if there is one, says the configuration of a network of other sizes.

    Raises:
        StepError: the weights are damaged or of another network.
    """
    path = Path(path)
    beside = path.with_suffix(SIZES)
    try:
        configuration = Mast3rSettings(**json.loads(beside.read_text())) if beside.is_file() else Mast3rSettings()
    except (TypeError, ValueError) as error:
        raise StepError(f"{beside} is no configuration of MASt3R ({error}); delete it for the published network's") from None
    with torch.device("meta"):
        network = MASt3R(configuration)
    load_strictly(network, path)
    return network.eval().requires_grad_(False)
