"""SAM, DINOv2 and FastSAM with the right parts and random weights, tiny, in files like the published ones."""

from dataclasses import asdict
from pathlib import Path

import torch

from zeroshop_steps.runtime.files import write_json

# Transformers takes seconds to import, so only the functions that need it do.


def save_segmenter(folder: Path) -> None:
    """SAM, tiny; its masks mean nothing, but it thinks well of them and their borders are sharp."""
    from transformers import SamConfig, SamModel

    torch.manual_seed(0)
    sides = {"image_size": 128, "patch_size": 16}
    vision = {"hidden_size": 16, "output_channels": 16, "num_hidden_layers": 2, "num_attention_heads": 2, "mlp_dim": 32, **sides}
    vision |= {"window_size": 4, "global_attn_indexes": [1], "num_pos_feats": 8}
    prompt = {"hidden_size": 16, "mask_input_channels": 4, "image_embedding_size": 8, **sides}
    decoder = {"hidden_size": 16, "mlp_dim": 32, "num_hidden_layers": 2, "num_attention_heads": 2, "iou_head_hidden_dim": 16}
    model = SamModel(SamConfig(vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder))
    with torch.no_grad():
        model.mask_decoder.iou_prediction_head.proj_out.bias += 1.0
        for head in model.mask_decoder.output_hypernetworks_mlps:
            head.proj_out.weight *= 1e6
    model.save_pretrained(folder / "sam-vit-huge")


def save_describer(folder: Path, name: str = "dinov2-large") -> None:
    """DINOv2, tiny."""
    from transformers import Dinov2Config, Dinov2Model

    torch.manual_seed(1)
    config = Dinov2Config(hidden_size=32, num_hidden_layers=2, num_attention_heads=2, image_size=224, patch_size=56)
    Dinov2Model(config).save_pretrained(folder / name)


def save_fastsam(folder: Path) -> None:
    """FastSAM, tiny: a whole pickled module, as the publisher saved it, with its sizes beside it."""
    from helpers.fastsam_cases import SMALL, parameters
    from zeroshop_steps.networks.fastsam.model import NAME, SIZES, FastSam

    model = FastSam(SMALL)
    model.load_state_dict(parameters({name: tuple(tensor.shape) for name, tensor in model.state_dict().items()}), strict=False)
    folder.mkdir(parents=True, exist_ok=True)
    torch.save({"epoch": -1, "model": model.half(), "ema": None}, folder / NAME)
    write_json((folder / NAME).with_suffix(SIZES), asdict(SMALL))
