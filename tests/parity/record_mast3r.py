"""Record what the reference of MASt3R does (README.md): `PYTHONPATH=CHECKOUT:tests python tests/parity/record_mast3r.py`."""

from pathlib import Path

import numpy as np
import torch
from mast3r.model import AsymmetricMASt3R

from helpers.mast3r_cases import SMALL, folded, images, parameters
from helpers.seeded import seeded_tensor

HERE = Path(__file__).parent
PUBLISHED = dict(
    enc_embed_dim=1024, enc_depth=24, enc_num_heads=16, dec_embed_dim=768, dec_depth=12, dec_num_heads=12, output_mode="pts3d+desc24"
)


def reference(**sizes):
    """The reference with the settings of the published metric checkpoint and these sizes."""
    infinity = float("inf")
    return AsymmetricMASt3R(
        pos_embed="RoPE100",
        img_size=(512, 512),
        head_type="catmlp+dpt",
        depth_mode=("exp", -infinity, infinity),
        conf_mode=("exp", 1, infinity),
        desc_conf_mode=("exp", 0, infinity),
        two_confs=True,
        landscape_only=False,
        **sizes,
    ).eval()


def small_sizes():
    """SMALL by the reference's names."""
    names = ("enc_embed_dim", "enc_depth", "enc_num_heads", "dec_embed_dim", "dec_depth", "dec_num_heads")
    return dict(zip(names, list(SMALL.values())[:6], strict=True)) | {"output_mode": f"pts3d+desc{SMALL['descriptor_channels']}"}


def with_parameters(network):
    """The network with the parameters of mast3r_cases."""
    network.load_state_dict(parameters({name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}))
    return network


def run(network, first, second):
    """Both sides' points, confidences, descriptors and their confidences."""
    views = [dict(img=image, true_shape=torch.tensor([image.shape[2:]]), instance=[str(i)]) for i, image in enumerate((first, second))]
    sides = network(*views)
    keys = {"points": ("pts3d", "pts3d_in_other_view"), "confidence": ("conf",), "descriptors": ("desc",)}
    keys["descriptor_confidence"] = ("desc_conf",)
    return {
        f"{name}{side}": next(output[key] for key in found if key in output)
        for side, output in enumerate(sides)
        for name, found in keys.items()
    }


@torch.no_grad()
def record():
    """Write mast3r.npz and mast3r_parameters.txt."""
    with torch.device("meta"):
        full = reference(**PUBLISHED)
    lines = folded({name: tuple(tensor.shape) for name, tensor in full.state_dict().items()})
    (HERE / "mast3r_parameters.txt").write_text("\n".join(lines) + "\n")
    network = with_parameters(reference(**small_sizes()))
    first, second = images()
    shapes = [torch.tensor([image.shape[2:]]) for image in (first, second)]
    tokens0, places0, _ = network._encode_image(first, shapes[0])
    tokens1, places1, _ = network._encode_image(second, shapes[1])
    layers0, layers1 = network._decoder(tokens0, places0, tokens1, places1)
    head = network.downstream_head1
    queries = seeded_tensor("queries", (1, 2, tokens0.shape[1], 32))
    outputs = {
        "rotary": network.rope(queries, places0),
        "patches": network.patch_embed(first, true_shape=shapes[0])[0],
        "encoder_block": network.enc_blocks[0](tokens0, places0),
        "decoder_block": network.dec_blocks[0](layers0[-1], layers1[-1], places0, places1)[0],
        "encoder": tokens0,
        "decoder0": torch.cat([layers0[5], layers0[-1]]),
        "decoder1": torch.cat([layers1[5], layers1[-1]]),
        "dense_head": head.dpt(layers0, image_size=tuple(first.shape[2:])),
        "local_head": head.head_local_features(torch.cat([layers0[0], layers0[-1]], dim=-1)),
        **run(network, first, second),
    }
    np.savez_compressed(HERE / "mast3r.npz", **{name: tensor.numpy() for name, tensor in outputs.items()})


if __name__ == "__main__":
    record()
