"""Record what the published Depth Anything 3 answers, for networks/da3/test_model.py (README.md says how).

Needs the reference (README.md), einops, addict and omegaconf; the tests need only what is written here.
"""

import re
from collections import Counter
from pathlib import Path

import numpy as np
import torch
from depth_anything_3.cfg import create_object, load_config
from depth_anything_3.model.cam_dec import CameraDec
from depth_anything_3.model.cam_enc import CameraEnc
from depth_anything_3.model.da3 import DepthAnything3Net
from depth_anything_3.model.dinov2.dinov2 import DinoV2
from depth_anything_3.model.dinov2.vision_transformer import DinoVisionTransformer
from depth_anything_3.model.dualdpt import DualDPT
from depth_anything_3.model.utils.transform import extri_intri_to_pose_encoding
from depth_anything_3.utils.geometry import affine_inverse

from helpers import da3_cases as cases
from helpers.named_parameters import fill

FOLDER = Path(__file__).parent
COLOR_MEAN, COLOR_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


def small_network() -> DepthAnything3Net:
    """The reference with every size reduced that its classes let one choose."""
    starts = {"alt_start": cases.ALONE, "qknorm_start": cases.ALONE, "rope_start": cases.ALONE}
    backbone = DinoV2("vits", list(cases.LAYERS), **starts)
    side_px = cases.GRID * cases.PATCH_PX
    sizes = {"embed_dim": cases.WIDTH, "depth": cases.DEPTH, "num_heads": cases.HEADS}
    backbone.pretrained = DinoVisionTransformer(img_size=side_px, patch_size=cases.PATCH_PX, **sizes, **starts)
    head = DualDPT(2 * cases.WIDTH, output_dim=2, features=cases.FEATURES, out_channels=cases.CHANNELS)
    encoder = CameraEnc(cases.WIDTH, trunk_depth=cases.CAMERA_DEPTH, num_heads=cases.CAMERA_HEADS)
    return fill(DepthAnything3Net(backbone, head, CameraDec(2 * cases.WIDTH), encoder))


def list_parameters(path: Path) -> None:
    """The names and the shapes in both published sizes, blocks that are alike in one line; a tensor that is shared has one name."""
    networks = [create_object(load_config(f"depth_anything_3.configs.da3-{size}")) for size in ("small", "base")]
    shapes = [{name: "x".join(map(str, parameter.shape)) for name, parameter in network.named_parameters()} for network in networks]
    lines = Counter(re.sub(r"(blocks|trunk)\.\d+\.", r"\1.*.", f"{name} {shape} {shapes[1][name]}") for name, shape in shapes[0].items())
    path.write_text("".join(f"{count} {line}\n" for line, count in sorted(lines.items())))


def normalise(images: torch.Tensor) -> torch.Tensor:
    """(1, S, 3, H, W) of (S, 3, H, W) in 0 to 1."""
    mean, std = (torch.tensor(values)[:, None, None] for values in (COLOR_MEAN, COLOR_STD))
    return ((images - mean) / std)[None]


def made_cameras() -> tuple[torch.Tensor, torch.Tensor]:
    """(1, S, 4, 4) camera_from_world and (1, S, 3, 3) intrinsics."""
    turns, _ = torch.linalg.qr(cases.inputs("turns", cases.FRAMES, 3, 3).double() + 2 * torch.eye(3))
    turns *= torch.linalg.det(turns)[:, None, None]
    poses = torch.eye(4).repeat(cases.FRAMES, 1, 1)
    poses[:, :3, :3], poses[:, :3, 3] = turns.float(), cases.inputs("places", cases.FRAMES, 3)
    height, width = cases.SIZE_PX
    intrinsics = torch.tensor([[60.0, 0, width / 2], [0, 50.0, height / 2], [0, 0, 1]]).repeat(cases.FRAMES, 1, 1)
    return poses[None], intrinsics[None]


@torch.no_grad()
def main() -> None:
    """Record every module and the whole network."""
    list_parameters(FOLDER / "da3_parameters.txt")
    network = small_network()
    images, found = cases.images(), {}
    for frames in (2, cases.FRAMES):
        kept, _ = network.backbone(normalise(images[:frames]))
        found |= {f"backbone_{frames}.layers": torch.cat([part[0] for part in kept]), f"backbone_{frames}.camera": kept[-1][1][0]}
    dense = network.head([(layer[None], None) for layer in cases.layers()], *cases.SIZE_PX, patch_start_idx=0)
    found |= {f"dual_head.{name}": dense[name][0] for name in ("depth", "depth_conf", "ray", "ray_conf")}
    found["camera_decoder.encodings"] = network.cam_dec(cases.inputs("camera", 1, cases.FRAMES, 2 * cases.WIDTH))[0]
    extrinsics, intrinsics = made_cameras()
    found["known"] = extri_intri_to_pose_encoding(affine_inverse(extrinsics), intrinsics, cases.SIZE_PX)[0]
    found["camera_encoder.tokens"] = network.cam_enc(extrinsics, intrinsics, cases.SIZE_PX)[0]
    for name, cameras in (("whole", (None, None)), ("whole_known", (extrinsics, intrinsics))):
        answer = network(normalise(images), *cameras)
        found |= {f"{name}.{key}": answer[key][0] for key in ("depth", "depth_conf", "extrinsics", "intrinsics")}
    np.savez_compressed(FOLDER / "da3.npz", **{key: value.numpy() for key, value in found.items()})


if __name__ == "__main__":
    main()
