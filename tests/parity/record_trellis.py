"""Record what the published TRELLIS answers, for networks/trellis/test_parity.py (README.md says how).

Needs the references, spconv and easydict (README.md); the tests need only what is written here.
"""

import importlib.machinery
import os
import re
import sys
import types
from pathlib import Path

import numpy as np
import torch

from helpers.named_parameters import fill, noise
from helpers.small_trellis import SMALL

FOLDER = Path(__file__).parent
CHECKOUT = Path(sys.argv[1])
PARAMETERS = FOLDER / "trellis_parameters.txt"
IMAGE_TOKENS, VOXELS, KEPT_ROWS = 7, 60, 97


def module(name: str, **members: object) -> types.ModuleType:
    """A module that stands in for one that is not installed, or for a package whose own imports are not."""
    made = types.ModuleType(name)
    made.__spec__ = importlib.machinery.ModuleSpec(name, None)
    made.__dict__.update(members)
    sys.modules[name] = made
    return made


def attend(q: torch.Tensor, k: torch.Tensor, v: torch.Tensor, mask: list[tuple[int, int]] | None = None) -> torch.Tensor:
    """What xformers' memory-efficient attention computes: (1, T, heads, width), with blocks of so many queries and keys."""
    if mask is None:
        q, k, v = (x.transpose(1, 2) for x in (q, k, v))
        return torch.nn.functional.scaled_dot_product_attention(q, k, v).transpose(1, 2)
    queries, keys = q.split([a for a, _ in mask], 1), [x.split([b for _, b in mask], 1) for x in (k, v)]
    return torch.cat([attend(a, b, c) for a, b, c in zip(queries, *keys, strict=True)], 1)


class BlockDiagonalMask:
    """xformers' mask: tokens of a block attend to those of the same block."""

    @staticmethod
    def from_seqlens(queries: list[int], keys: list[int] | None = None) -> list[tuple[int, int]]:
        return list(zip(queries, keys or queries, strict=True))


os.environ |= {"ATTN_BACKEND": "xformers", "SPCONV_ALGO": "native"}
operations = module("xformers.ops", memory_efficient_attention=attend, fmha=types.SimpleNamespace(BlockDiagonalMask=BlockDiagonalMask))
module("xformers", ops=operations)
for name in ("trellis", "trellis.models", "trellis.modules", "trellis.models.structured_latent_vae"):
    module(name, __path__=[str(CHECKOUT / name.replace(".", "/"))])
features = types.SimpleNamespace(feats_channels=101)
module("trellis.representations", __path__=[], MeshExtractResult=None)
module("trellis.representations.mesh", SparseFeatures2Mesh=lambda **_: features)
module("trellis.models.sparse_elastic_mixin", SparseTransformerElasticMixin=type("Mixin", (), {}))

from trellis.models.sparse_structure_flow import SparseStructureFlowModel  # noqa: E402
from trellis.models.sparse_structure_vae import SparseStructureDecoder  # noqa: E402
from trellis.models.structured_latent_flow import SLatFlowModel  # noqa: E402
from trellis.models.structured_latent_vae.base import SparseTransformerBase  # noqa: E402
from trellis.models.structured_latent_vae.decoder_mesh import SLatMeshDecoder  # noqa: E402
from trellis.modules.sparse import SparseTensor  # noqa: E402

module("trellis.pipelines", __path__=[str(CHECKOUT / "trellis/pipelines")])
from trellis.pipelines.samplers import FlowEulerGuidanceIntervalSampler  # noqa: E402

PUBLISHED = {
    "structure_flow": (SparseStructureFlowModel, "generation/ss_flow_img_dit_L_16l8_fp16", "denoiser"),
    "structure_decoder": (SparseStructureDecoder, "vae/ss_vae_conv3d_16l8_fp16", "decoder"),
    "latent_flow": (SLatFlowModel, "generation/slat_flow_img_dit_L_64l8p2_fp16", "denoiser"),
    "mesh_decoder": (SLatMeshDecoder, "vae/slat_vae_dec_mesh_swin8_B_64l8_fp16", "decoder"),
}


def flow_arguments(settings) -> dict:
    """The reference's words for the sizes of a flow."""
    return {
        "resolution": settings.resolution,
        "in_channels": settings.channels,
        "out_channels": settings.channels,
        "model_channels": settings.width,
        "cond_channels": settings.condition_width,
        "num_blocks": settings.blocks,
        "num_heads": settings.heads,
        "qk_rms_norm": True,
    }


def small_networks() -> dict[str, torch.nn.Module]:
    """The reference in the small sizes."""
    decoder, meshes = SMALL.structure_decoder, SMALL.mesh_decoder
    return {
        "structure_flow": SparseStructureFlowModel(**flow_arguments(SMALL.structure_flow), patch_size=1),
        "structure_decoder": SparseStructureDecoder(1, decoder.latent_channels, 2, list(decoder.channels)),
        "latent_flow": SLatFlowModel(
            **flow_arguments(SMALL.latent_flow), patch_size=2, num_io_res_blocks=2, io_block_channels=[SMALL.latent_flow.io_channels]
        ),
        "mesh_decoder": SLatMeshDecoder(
            resolution=meshes.resolution,
            model_channels=meshes.width,
            latent_channels=meshes.latent_channels,
            num_blocks=meshes.blocks,
            num_heads=meshes.heads,
            window_size=meshes.window,
            representation_config={"use_color": True},
        ),
    }


def list_parameters() -> None:
    """Names, shapes and bytes an element of the published networks, blocks that are alike in one line."""
    import json

    lines: dict[str, int] = {}
    for name, (kind, config, part) in PUBLISHED.items():
        arguments = json.loads((CHECKOUT / "configs" / f"{config}.json").read_text())["models"][part]["args"]
        for key, value in kind(**arguments).state_dict().items():
            folded = re.sub(r"^blocks\.\d+\.", "blocks.*.", key) if name != "structure_decoder" else key
            line = f"{name}.{folded} {'x'.join(map(str, value.shape))} {value.element_size()}"
            lines[line] = lines.get(line, 0) + 1
    PARAMETERS.write_text("".join(f"{count} {line}\n" for line, count in sorted(lines.items())))


def inputs(name: str, *shape: int) -> torch.Tensor:
    """Made-up inputs of a module."""
    return torch.from_numpy(noise(name, shape))


def places(count: int, resolution: int) -> torch.Tensor:
    """(count, 4) int32 voxels of a sparse tensor, in no order."""
    order = np.argsort(noise("places", (resolution**3,)))[:count]
    return torch.tensor(np.stack([0 * order, *np.unravel_index(order, (resolution,) * 3)], 1).astype(np.int32))


def decode_features(network: SLatMeshDecoder, latents: SparseTensor) -> SparseTensor:
    """The mesh decoder up to the features that the mesh is taken from."""
    hidden = SparseTransformerBase.forward(network, latents)
    for block in network.upsample:
        hidden = block(hidden)
    return network.out_layer(hidden)


def record(**values: torch.Tensor) -> None:
    np.savez_compressed(FOLDER / "trellis.npz", **{key: value.numpy() for key, value in values.items()})


@torch.no_grad()
def main() -> None:
    """Record every network and the whole."""
    list_parameters()
    networks = {name: fill(network) for name, network in small_networks().items()}
    for part in (part for network in networks.values() for part in network.modules()):
        if type(part).__name__ == "SubMConv3d":
            part.train()  # ready for inference, spconv adds the bias within its kernel, which it has for CUDA alone
    flow = SMALL.structure_flow
    tokens = inputs("tokens", 2, IMAGE_TOKENS, flow.condition_width)
    grid = inputs("grid", 1, flow.channels, *(flow.resolution,) * 3)
    time = torch.tensor([612.5])
    found = {"structure_velocity": networks["structure_flow"](grid, time, tokens[:1])}
    found["logits"] = networks["structure_decoder"](grid)
    coordinates = places(VOXELS, SMALL.latent_flow.resolution)
    latents = SparseTensor(inputs("latents", VOXELS, SMALL.latent_flow.channels), coordinates)
    found["places"] = coordinates[:, 1:]
    found["latent_velocity"] = networks["latent_flow"](latents, time, tokens[:1]).feats
    found["features"] = decode_features(networks["mesh_decoder"], latents).feats[::KEPT_ROWS]
    found |= record_whole(networks, tokens, grid)
    record(**found)


def record_whole(networks: dict[str, torch.nn.Module], tokens: torch.Tensor, grid: torch.Tensor) -> dict[str, torch.Tensor]:
    """Both flows sampled with two pictures in turns, and what the decoders make of it."""
    sampler = FlowEulerGuidanceIntervalSampler(1e-5)
    inference, step = sampler._inference_model, iter(range(2 * SMALL.sampler.steps))

    def in_turns(model, x, t, cond, **keywords):
        index = next(step) % len(tokens)
        return inference(model, x, t, tokens[index : index + 1], **keywords)

    sampler._inference_model = in_turns
    options = {
        "cond": tokens,
        "neg_cond": torch.zeros_like(tokens[:1]),
        "steps": SMALL.sampler.steps,
        "rescale_t": SMALL.sampler.rescale,
        "cfg_strength": SMALL.sampler.guidance,
        "cfg_interval": SMALL.sampler.interval,
        "verbose": False,
    }
    structure = sampler.sample(networks["structure_flow"], grid, **options).samples
    logits = networks["structure_decoder"](structure)
    coordinates = torch.argwhere(logits > 0)[:, [0, 2, 3, 4]].int()
    state = SparseTensor(inputs("noise", len(coordinates), SMALL.latent_flow.channels), coordinates)
    latents = sampler.sample(networks["latent_flow"], state, **options).samples
    latents = latents * torch.tensor(SMALL.latent_std)[None] + torch.tensor(SMALL.latent_mean)[None]
    features = decode_features(networks["mesh_decoder"], latents).feats[::KEPT_ROWS]
    return {"whole_structure": structure, "whole_places": coordinates[:, 1:], "whole_latents": latents.feats, "whole_features": features}


if __name__ == "__main__":
    main()
