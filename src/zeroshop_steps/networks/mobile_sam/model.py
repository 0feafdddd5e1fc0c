"""MobileSAM (Zhang et al. 2023): kornia's TinyViT with the prompt encoder and mask decoder of Segment Anything in transformers."""

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from zeroshop_steps.networks.imagenet import LEVEL_DEVIATION, LEVEL_MEAN
from zeroshop_steps.networks.weights import load_strictly

SIDE_PX = 512
"""Of the square that an image is scaled into. At 1024, as in training, it takes 4.5 times longer; masks in boxes overlap a little more with
the object then (0.975, at 512 0.960, 40 photos), but those at points of it take its surroundings along more often (0.872 and 0.943)."""
FEATURE_PX = 16  # pixels of that square for each feature
MEAN, DEVIATION = np.array(LEVEL_MEAN, np.float32), np.array(LEVEL_DEVIATION, np.float32)
RENAMED = (
    (r"prompt_encoder\.pe_layer\.positional_encoding_gaussian_matrix", "prompt_encoder.shared_embedding.positional_embedding"),
    (r"point_embeddings\.", "point_embed."),
    (r"mask_downscaling\.0\.", "mask_embed.conv1."),
    (r"mask_downscaling\.1\.", "mask_embed.layer_norm1."),
    (r"mask_downscaling\.3\.", "mask_embed.conv2."),
    (r"mask_downscaling\.4\.", "mask_embed.layer_norm2."),
    (r"mask_downscaling\.6\.", "mask_embed.conv3."),
    (r"mask_decoder\.(.*)\.norm(\d)\.", r"mask_decoder.\1.layer_norm\2."),
    (r"\.norm_final_attn\.", ".layer_norm_final_attn."),
    (r"output_upscaling\.0\.", "upscale_conv1."),
    (r"output_upscaling\.1\.", "upscale_layer_norm."),
    (r"output_upscaling\.3\.", "upscale_conv2."),
    (r"(hypernetworks_mlps\.\d|prediction_head)\.layers\.0\.", r"\1.proj_in."),
    (r"(hypernetworks_mlps\.\d|prediction_head)\.layers\.1\.", r"\1.layers.0."),
    (r"(hypernetworks_mlps\.\d|prediction_head)\.layers\.2\.", r"\1.proj_out."),
)  # from the published names to those of transformers


@dataclass(frozen=True)
class Features:
    """What the encoder makes of an image.

    Attributes:
        features: (1, C, F, F), F = SIDE_PX / FEATURE_PX.
        size_px: (width, height) of the image in the square.
    """

    features: Tensor
    size_px: tuple[int, int]


class _MobileSam(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        from kornia.models.tiny_vit import TinyViT
        from transformers import SamConfig
        from transformers.models.sam.modeling_sam import SamMaskDecoder, SamPromptEncoder

        config = SamConfig()
        config.mask_decoder_config._attn_implementation = "sdpa"
        config.prompt_encoder_config.image_size = SIDE_PX
        config.prompt_encoder_config.image_embedding_size = SIDE_PX // FEATURE_PX
        self.image_encoder = TinyViT.from_config("5m", img_size=SIDE_PX, mobile_sam=True)
        self.prompt_encoder = SamPromptEncoder(config)
        self.mask_decoder = SamMaskDecoder(config.mask_decoder_config)


class MobileSam:
    """The network of a file, on the processor."""

    def __init__(self, path: Path) -> None:
        """Read the parameters. Raises StepError if the file is missing, damaged, or of another network."""
        self.path = path
        self._net = _MobileSam()
        load_strictly(self._net, path, rename_parameters)
        self._net.eval()
        fuse_normalizations(self._net.image_encoder)
        self._net.image_encoder.to(memory_format=torch.channels_last)  # as images are; a fifth faster
        self._positions = self._encode_positions()

    @torch.inference_mode()
    def encode(self, image: np.ndarray) -> Features:
        """The features of an (H, W, 3) RGB image, 0 to 255."""
        height, width = image.shape[:2]
        scale = SIDE_PX / max(height, width)
        size_px = max(1, round(width * scale)), max(1, round(height * scale))
        shrinks = scale < 1
        resized = cv2.resize(image, size_px, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        square = np.zeros((SIDE_PX, SIDE_PX, 3), np.float32)
        square[: size_px[1], : size_px[0]] = (resized - MEAN) / DEVIATION
        return Features(self._net.image_encoder(torch.from_numpy(square).permute(2, 0, 1)[None]), size_px)

    @torch.inference_mode()
    def decode(
        self,
        of_image: Features,
        points: np.ndarray | None = None,
        labels: np.ndarray | None = None,
        box: np.ndarray | None = None,
    ) -> np.ndarray:
        """Masks of what is asked for.

        Args:
            of_image: the features.
            points: (P, 2) x and y, as shares of the image's width and height.
            labels: (P,) 1 for points of the object, 0 for points beside it.
            box: (2, 2), its upper left and lower right corner, likewise.

        Returns:
            (3, H, W) float32 log odds of the image, a quarter of its size in the square: of a part, a whole and a group.
        """
        size = np.array(of_image.size_px, np.float32)
        asked = None if points is None else torch.from_numpy((points * size).astype(np.float32))[None, None]
        told = None if labels is None else torch.from_numpy(labels.astype(np.int64))[None, None]
        around = None if box is None else torch.from_numpy((box * size).astype(np.float32).reshape(1, 1, 4))
        sparse, dense = self._net.prompt_encoder(asked, told, around, None)
        odds, _ = self._net.mask_decoder(of_image.features, self._positions, sparse, dense, multimask_output=True)
        rows, columns = (-(-side // 4) for side in of_image.size_px[::-1])
        return np.asarray(odds[0, 0, :, :rows, :columns].numpy())

    def _encode_positions(self) -> Tensor:
        """(1, C, F, F): where each feature is."""
        count = SIDE_PX // FEATURE_PX
        steps = (torch.arange(count) + 0.5) / count
        rows, columns = torch.meshgrid(steps, steps, indexing="ij")
        with torch.inference_mode():
            return self._net.prompt_encoder.shared_embedding(torch.stack([columns, rows], -1)).permute(2, 0, 1)[None]


def fuse_normalizations(encoder: nn.Module) -> None:
    """Join batch normalizations with their convolutions, which gives the same in half the passes over memory."""
    from kornia.models.tiny_vit import ConvBN

    for module in encoder.modules():
        if isinstance(module, ConvBN):
            module.c, module.bn = fuse_conv_bn_eval(module.c, module.bn), nn.Identity()


def rename_parameters(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The published parameters by the names of this network."""
    renamed = {}
    for name, tensor in tensors.items():
        for before, after in RENAMED:
            name = re.sub(before, after, name)
        renamed[name] = tensor
    return renamed
