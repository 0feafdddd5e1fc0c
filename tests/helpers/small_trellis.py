"""A TRELLIS of small sizes with random weights: for parity, and in files like the published ones."""

from dataclasses import asdict
from pathlib import Path

import torch
from safetensors.torch import save_file

from zeroshop_steps.networks.trellis.settings import (
    FlowSettings,
    MeshDecoderSettings,
    SamplerSettings,
    StructureDecoderSettings,
    TrellisSettings,
)

SMALL = TrellisSettings(
    structure_flow=FlowSettings(resolution=4, channels=4, width=48, blocks=2, heads=2, condition_width=40),
    structure_decoder=StructureDecoderSettings(latent_channels=4, channels=(24, 12)),
    latent_flow=FlowSettings(resolution=8, channels=4, width=48, blocks=2, heads=2, condition_width=40, io_channels=16),
    mesh_decoder=MeshDecoderSettings(resolution=8, latent_channels=4, width=256, blocks=3, heads=4, window=4),
    sampler=SamplerSettings(steps=4),
    image_px=56,
    latent_mean=(-1.0, 0.0, 0.5, 1.0),
    latent_std=(2.0, 1.5, 1.0, 0.5),
)


def write_networks(folder: Path) -> None:
    """Random weights and their sizes, in files like the published ones."""
    from helpers.named_parameters import fill
    from zeroshop_steps.networks.trellis.generator import NETWORKS, SIZES_FILE
    from zeroshop_steps.runtime.files import write_json

    for name, network in make_networks(SMALL).items():
        folder.mkdir(parents=True, exist_ok=True)
        save_file({key: value.contiguous() for key, value in fill(network).state_dict().items()}, folder / f"{name}.safetensors")
    assert set(NETWORKS) == set(make_networks(SMALL))
    write_json(folder / SIZES_FILE, asdict(SMALL))


def write_encoder(folder: Path) -> None:
    """A DINOv2 with registers of small sizes and random weights, as the transformers library saves it."""
    from transformers import Dinov2WithRegistersConfig, Dinov2WithRegistersModel

    torch.manual_seed(0)
    width = SMALL.structure_flow.condition_width
    config = Dinov2WithRegistersConfig(
        hidden_size=width, num_hidden_layers=2, num_attention_heads=2, image_size=SMALL.image_px, patch_size=14, num_register_tokens=4
    )
    Dinov2WithRegistersModel(config).save_pretrained(folder)


def make_networks(settings: TrellisSettings) -> dict[str, torch.nn.Module]:
    """Our networks by name, in these sizes."""
    from zeroshop_steps.networks.trellis.decoders import MeshDecoder, StructureDecoder
    from zeroshop_steps.networks.trellis.flows import LatentFlow, StructureFlow

    kinds = {"structure_flow": StructureFlow, "structure_decoder": StructureDecoder, "latent_flow": LatentFlow, "mesh_decoder": MeshDecoder}
    return {name: kind(getattr(settings, name)) for name, kind in kinds.items()}
