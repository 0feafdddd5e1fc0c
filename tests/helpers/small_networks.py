"""Grounding DINO and SAM 2 with the right parts and random weights, a thousandth of the size, in folders as `save_pretrained` writes them.

The small SAM 2 is taught one thing, where its weights would otherwise say nothing: that what is red is the object.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

if TYPE_CHECKING:
    from transformers import Sam2VideoModel

# Transformers takes seconds to import, so only the functions that need it do.
SIDE_PX, HIDDEN = 128, 128
WORDS = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", ".", "object", "in", "the", "middle", "red", "ball"]


def write_detector(folder: Path, seed: int = 0) -> None:
    """A Grounding DINO whose boxes are random."""
    from tokenizers import BertWordPieceTokenizer
    from transformers import (
        BertConfig,
        BertTokenizerFast,
        GroundingDinoConfig,
        GroundingDinoForObjectDetection,
        GroundingDinoImageProcessorPil,
        SwinConfig,
    )

    torch.manual_seed(seed)
    backbone = SwinConfig(image_size=64, embed_dim=8, depths=[1, 1, 1, 1], num_heads=[1, 1, 2, 2], window_size=4, out_indices=[2, 3, 4])
    text = BertConfig(vocab_size=len(WORDS), hidden_size=16, num_hidden_layers=1, num_attention_heads=2, intermediate_size=32)
    config = GroundingDinoConfig(
        backbone_config=backbone, text_config=text, num_queries=20, d_model=32, encoder_layers=1, decoder_layers=2, encoder_ffn_dim=32,
        decoder_ffn_dim=32, encoder_attention_heads=2, decoder_attention_heads=2, encoder_n_points=2, decoder_n_points=2,
    )  # fmt: skip
    GroundingDinoForObjectDetection(config).save_pretrained(folder)
    GroundingDinoImageProcessorPil(size={"shortest_edge": 96, "longest_edge": 160}).save_pretrained(folder)
    tokenizer = BertWordPieceTokenizer(vocab={word: index for index, word in enumerate(WORDS)})
    BertTokenizerFast(tokenizer_object=tokenizer._tokenizer).save_pretrained(folder)


def write_tracker(folder: Path, seed: int = 0) -> None:
    """A SAM 2 that finds what is red."""
    from transformers import (
        Sam2HieraDetConfig,
        Sam2VideoConfig,
        Sam2VideoMaskDecoderConfig,
        Sam2VideoModel,
        Sam2VideoPromptEncoderConfig,
        Sam2VisionConfig,
    )

    torch.manual_seed(seed)
    backbone = Sam2HieraDetConfig(
        image_size=[SIDE_PX, SIDE_PX], hidden_size=8, blocks_per_stage=[1, 1, 2, 1], embed_dim_per_stage=[8, 16, 32, 64],
        num_attention_heads_per_stage=[1, 1, 2, 2], window_size_per_stage=[4, 4, 4, 4], global_attention_blocks=[3],
    )  # fmt: skip
    sizes = [[SIDE_PX // stride] * 2 for stride in (4, 8, 16)]
    config = Sam2VideoConfig(
        vision_config=Sam2VisionConfig(
            backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], backbone_feature_sizes=sizes, fpn_hidden_size=HIDDEN
        ),
        prompt_encoder_config=Sam2VideoPromptEncoderConfig(hidden_size=HIDDEN, image_size=SIDE_PX),
        mask_decoder_config=Sam2VideoMaskDecoderConfig(hidden_size=HIDDEN, mlp_dim=32, num_attention_heads=2, iou_head_hidden_dim=16),
        image_size=SIDE_PX, memory_attention_hidden_size=HIDDEN, memory_attention_num_layers=1,
        memory_attention_feed_forward_hidden_size=32, memory_encoder_hidden_size=HIDDEN, memory_encoder_output_channels=64,
        memory_attention_rope_feat_sizes=sizes[-1], mask_downsampler_embed_dim=HIDDEN, memory_fuser_embed_dim=HIDDEN,
        memory_fuser_intermediate_dim=32, memory_fuser_num_layers=1,
    )  # fmt: skip
    model = Sam2VideoModel(config).eval()
    _teach_red(model)
    model.save_pretrained(folder)


@torch.no_grad()
def _teach_red(model: "Sam2VideoModel") -> None:
    """Make the mask a linear function of the finest features, fitted to which pixels of random pictures are red."""
    decoder = model.mask_decoder
    generator = np.random.default_rng(0)
    features, targets = [], []
    for _ in range(6):
        red = np.kron(generator.random((8, 8)) < 0.4, np.ones((SIDE_PX // 8,) * 2)) > 0
        image = generator.integers(60, 200, (SIDE_PX, SIDE_PX, 1)).repeat(3, 2).astype(np.float32)
        image[red] = (200, 30, 30)
        pixels = (torch.from_numpy(image / 255).permute(2, 0, 1)[None].float() - 0.45) / 0.225
        finest = model.get_image_features(pixels, return_dict=True).fpn_hidden_states[0]  # (HW, 1, C)
        features.append(torch.nn.functional.gelu(finest[:, 0]))
        targets.append(torch.from_numpy(red[2::4, 2::4].ravel() * 12.0 - 6.0))
    weights = torch.linalg.lstsq(torch.cat(features).double(), torch.cat(targets)[:, None].double()).solution[:, 0].float()
    for part in (decoder.upscale_conv2, *(mlp.proj_out for mlp in decoder.output_hypernetworks_mlps), decoder.pred_obj_score_head.proj_out):
        part.weight.zero_()
        part.bias.zero_()
    for mlp in decoder.output_hypernetworks_mlps:
        mlp.proj_out.bias.copy_(weights)
    decoder.pred_obj_score_head.proj_out.bias.fill_(10.0)
