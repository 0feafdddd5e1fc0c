"""Render with the CUDA kernels in Numba's simulator and with their float64 twin, and keep images and gradients in a file.

A program of its own, as the simulator has to be chosen before Numba is imported: NUMBA_ENABLE_CUDASIM=1 python simulated_cuda.py IN OUT
"""

import sys

import numpy as np
import torch

from zeroshop_steps.surface.twodgs.blending import make_blending
from zeroshop_steps.surface.twodgs.reference import render_reference
from zeroshop_steps.surface.twodgs.render import RenderView, render

NAMES = ("positions", "log_scales", "quaternions", "opacity_logits", "sh")


def main(source: str, out: str) -> None:
    given = np.load(source)
    width_px, height_px = (int(value) for value in given["size_px"])
    view = RenderView(given["camera"], width_px, height_px, given["tile_active"], float(given["near"]), tuple(given["depth_map"].tolist()))
    blending = make_blending("cuda")
    ours = [torch.tensor(given[name], requires_grad=True) for name in NAMES]
    r = render(*ours, 3, view, distortion=True, blending=blending)
    image = torch.cat([r.color, r.depth[None], r.normal, r.alpha[None], r.median_depth[None], r.distortion[None]])
    twins = [torch.tensor(given[name].astype(np.float64), requires_grad=True) for name in NAMES]
    expected, undecided = render_reference(*twins, 3, torch.tensor(view.camera), width_px, height_px, view.near, view.depth_map)
    weights = torch.tensor(np.random.default_rng(1).normal(size=expected.shape)) * ~undecided
    (expected * weights).sum().backward()
    (image * weights.float()).sum().backward()
    kept = {"image": image.detach().numpy(), "expected": expected.detach().numpy(), "decided": ~undecided.numpy()}
    for name, tensor, twin in zip(NAMES, ours, twins, strict=True):
        kept |= {f"gradient_{name}": tensor.grad.numpy(), f"expected_{name}": twin.grad.numpy()}
    np.savez(out, **kept)


if __name__ == "__main__":
    main(*sys.argv[1:])
