"""Record what the reference of FoundationPose answers: `PYTHONPATH=CHECKOUT:tests python tests/parity/record_foundationpose.py`.

Its networks alone are run. Their files import all that the estimator needs, which is left out.
"""

import sys
import types
from pathlib import Path

import numpy as np
import torch

sys.modules["Utils"] = types.ModuleType("Utils")

from learning.models import network_modules, refine_network, score_network  # noqa: E402
from torch import nn  # noqa: E402

from helpers.foundationpose_cases import SMALL, lines, pairs, parameters  # noqa: E402

HERE = Path(__file__).parent


class Settings(dict):
    """Those of the published checkpoints, by key and by attribute."""

    def __getattr__(self, name):
        return self[name]


PUBLISHED = Settings(use_BN=True, rot_rep="axis_angle")


def small_encoders():
    """The encoder of an image, and that of a pair."""
    block, unit, norm = network_modules.ResnetBasicBlock, network_modules.ConvBNReLU, nn.BatchNorm2d
    stem, width, tokens = SMALL["stem"], SMALL["width"], SMALL["tokens"]

    def residual(channels):
        return block(channels, channels, bias=True, norm_layer=norm)

    image = [unit(6, stem, kernel_size=7, stride=2), unit(stem, width, kernel_size=3, stride=2), residual(width), residual(width)]
    pair = [residual(2 * width), residual(2 * width), unit(2 * width, tokens, kernel_size=3, stride=2), residual(tokens), residual(tokens)]
    return nn.Sequential(*image), nn.Sequential(*pair)


def small_refiner():
    """The refiner with every size reduced."""
    network = refine_network.RefineNet.__new__(refine_network.RefineNet)
    nn.Module.__init__(network)
    network.encodeA, network.encodeAB = small_encoders()
    network.pos_embed = network_modules.PositionalEmbedding(d_model=SMALL["tokens"], max_len=400)
    heads = [
        nn.Sequential(
            nn.TransformerEncoderLayer(SMALL["tokens"], SMALL["heads"], dim_feedforward=SMALL["hidden"], batch_first=True),
            nn.Linear(SMALL["tokens"], 3),
        )
        for _ in range(2)
    ]
    network.trans_head, network.rot_head = heads
    return network


def small_scorer():
    """The scorer with every size reduced."""
    network = score_network.ScoreNetMultiPair.__new__(score_network.ScoreNetMultiPair)
    nn.Module.__init__(network)
    network.encoderA, network.encoderAB = small_encoders()
    network.att, network.att_cross = (nn.MultiheadAttention(SMALL["tokens"], SMALL["heads"], batch_first=True) for _ in range(2))
    network.pos_embed = network_modules.PositionalEmbedding(d_model=SMALL["tokens"], max_len=400)
    network.linear = nn.Linear(SMALL["tokens"], 1)
    return network


def with_parameters(network):
    """The network with the parameters of foundationpose_cases."""
    network.load_state_dict(parameters(network.state_dict()))
    return network.eval()


def full_networks():
    """The refiner and the scorer in their published sizes."""
    return refine_network.RefineNet(PUBLISHED, c_in=6), score_network.ScoreNetMultiPair(PUBLISHED, c_in=6)


@torch.no_grad()
def record():
    """Write foundationpose.npz and foundationpose_*_parameters.txt."""
    with torch.device("meta"):
        full = full_networks()
    for name, network in zip(("refiner", "scorer"), full, strict=True):
        (HERE / f"foundationpose_{name}_parameters.txt").write_text("\n".join(lines(network.state_dict())) + "\n")
    rendered, observed = pairs()
    refiner, scorer = with_parameters(small_refiner()), with_parameters(small_scorer())
    image = refiner.encodeA(rendered)
    pair = refiner.encodeAB(torch.cat([image, refiner.encodeA(observed)], dim=1))
    tokens = refiner.pos_embed(pair.flatten(2).transpose(1, 2))
    update = refiner(rendered, observed)
    outputs = {
        "image_encoder": image,
        "pair_encoder": pair,
        "positions": refiner.pos_embed.pe,
        "transformer_block": refiner.rot_head[0](tokens),
        "translation": update["trans"],
        "turn": update["rot"],
        "description": scorer.extract_feat(rendered, observed),
        "scores": scorer(rendered, observed, L=len(rendered))["score_logit"][0],
        "scores_of_three": scorer(rendered[:3], observed[:3], L=3)["score_logit"][0],
    }
    np.savez_compressed(HERE / "foundationpose.npz", **{name: tensor.numpy() for name, tensor in outputs.items()})


if __name__ == "__main__":
    record()
