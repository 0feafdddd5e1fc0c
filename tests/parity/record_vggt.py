"""Record what the published VGGT answers, for networks/vggt/test_model.py (README.md says how).

Needs the reference (README.md), einops and huggingface_hub; the tests need only what is written here.
"""

import functools
import re
from pathlib import Path

import numpy as np
import torch
from vggt.heads.camera_head import CameraHead
from vggt.heads.dpt_head import DPTHead
from vggt.heads.track_head import TrackHead
from vggt.layers.vision_transformer import DinoVisionTransformer
from vggt.models.aggregator import Aggregator
from vggt.models.vggt import VGGT

from helpers.named_parameters import fill, noise

FOLDER = Path(__file__).parent
WIDTH, HEADS, LAYERS = 32, 2, [0, 1, 2, 3]
CHANNELS = [8, 12, 16, 16]
FRAMES, HEIGHT, WIDTH_PX = 3, 42, 70


def small_network() -> VGGT:
    """The reference with every size reduced that its classes let one choose."""
    network = VGGT.__new__(VGGT)
    torch.nn.Module.__init__(network)
    network.aggregator = Aggregator(img_size=70, embed_dim=WIDTH, depth=4, num_heads=HEADS, patch_embed="conv")
    network.aggregator.patch_embed = DinoVisionTransformer(
        img_size=70,
        patch_size=14,
        embed_dim=WIDTH,
        depth=2,
        num_heads=HEADS,
        init_values=1.0,
        block_chunks=0,
        num_register_tokens=4,
        interpolate_antialias=True,
        interpolate_offset=0.0,
    )
    dense = {"features": 16, "out_channels": CHANNELS, "intermediate_layer_idx": LAYERS}
    network.camera_head = CameraHead(2 * WIDTH, trunk_depth=2, num_heads=HEADS)
    network.point_head = DPTHead(2 * WIDTH, output_dim=4, activation="inv_log", conf_activation="expp1", **dense)
    network.depth_head = DPTHead(2 * WIDTH, output_dim=2, activation="exp", conf_activation="expp1", **dense)
    network.track_head = TrackHead(2 * WIDTH, features=16, corr_levels=3, hidden_size=32)
    network.track_head.feature_extractor = DPTHead(2 * WIDTH, feature_only=True, down_ratio=2, pos_embed=False, **dense)
    return fill(network)


def inputs(name: str, *shape: int) -> torch.Tensor:
    """Made-up inputs of a module."""
    return torch.from_numpy(noise(name, shape))


def record(name: str, **values: torch.Tensor) -> None:
    """Write the inputs and outputs of a module."""
    np.savez_compressed(FOLDER / f"vggt_{name}.npz", **{key: value.numpy() for key, value in values.items()})


def list_parameters(path: Path) -> None:
    """The names and shapes of the full network, blocks that are alike in one line."""
    linspace, torch.linspace = torch.linspace, functools.partial(torch.linspace, device="cpu")  # whose values it reads
    with torch.device("meta"):
        network = VGGT()
    torch.linspace = linspace
    lines: dict[str, int] = {}
    for name, parameter in network.named_parameters():
        line = re.sub(r"(blocks|trunk)\.\d+\.", r"\1.*.", name) + " " + "x".join(map(str, parameter.shape))
        lines[line] = lines.get(line, 0) + 1
    path.write_text("".join(f"{count} {line}\n" for line, count in sorted(lines.items())))


@torch.no_grad()
def main() -> None:
    """Record every module and the whole network."""
    network = small_network()
    list_parameters(FOLDER / "vggt_parameters.txt")
    images = inputs("images", FRAMES, 3, HEIGHT, WIDTH_PX) / 2 + 0.5
    query = (inputs("query", 6, 2) / 2 + 0.5) * torch.tensor([WIDTH_PX - 1.0, HEIGHT - 1.0])
    tokens = [inputs(f"tokens{index}", FRAMES, 5 + 15, 2 * WIDTH) for index in LAYERS]
    stacked, batched = torch.stack(tokens), [layer[None] for layer in tokens]
    record("patch_embed", images=images, tokens=network.aggregator.patch_embed(images)["x_norm_patchtokens"])
    record("aggregator", images=images, layers=torch.cat(network.aggregator(images[None])[0]))
    record("camera_head", tokens=tokens[-1][:, 0], encodings=network.camera_head(batched)[-1][0])
    for name, head in (("depth_head", network.depth_head), ("point_head", network.point_head)):
        values, confidence = head(batched, images[None], 5)
        record(name, layers=stacked, values=values[0], confidence=confidence[0])
    features = network.track_head.feature_extractor(batched, images[None], 5)[0]
    record("track_features", layers=stacked, features=features)
    maps = inputs("maps", *features.shape)
    xy, visibility, confidence = network.track_head.tracker(query[None], maps[None], iters=4)
    record("tracker", maps=maps, query=query, xy=xy[-1][0], visibility=visibility[0], confidence=confidence[0])
    flow = network.track_head.tracker.updateformer.flow_head
    for parameter in flow.parameters():
        parameter *= 100
    xy, visibility, confidence = network.track_head.tracker(query[None], maps[None], iters=2)
    record("tracker_far", xy=xy[-1][0], visibility=visibility[0], confidence=confidence[0])
    for parameter in flow.parameters():
        parameter /= 100
    whole = network(images, query)
    names = ("pose_enc", "depth", "depth_conf", "world_points", "world_points_conf", "track", "vis", "conf")
    record("whole", images=images, query=query, **{name: whole[name][0] for name in names})


if __name__ == "__main__":
    main()
