"""Render with the CUDA kernels in Numba's simulator and with their float64 twin, and keep images and gradients in a file.

A program of its own, as the simulator has to be chosen before Numba is imported; `simulate` calls it. Compiled functions that the kernels
share with the CPU's run as plain Python there.
"""

import sys
from pathlib import Path

import numpy as np
import torch

from helpers.simulator import run_in_simulator
from zeroshop_steps.surface.training import losses
from zeroshop_steps.surface.training.ssim import DeviceDissimilarity

SURFEL_TENSORS = ("positions", "log_scales", "quaternions", "opacity_logits", "sh")
VOXEL_TENSORS = ("densities", "sh")


def simulate(kind: str, folder: Path, **given: object) -> dict[str, np.ndarray]:
    """What a function of this module, by its name, makes of what it is given, in a process of its own with the simulator."""
    np.savez(folder / "in.npz", **given)
    run_in_simulator(__file__, kind, str(folder / "in.npz"), str(folder / "out.npz"))
    return dict(np.load(folder / "out.npz"))


def use_losses_of_a_device() -> None:
    """Tensors lie in the host's memory here, so that losses would take the CPU's way, in plain Python."""
    losses.dssim = DeviceDissimilarity.apply


def compare(names: tuple[str, ...], given: dict[str, np.ndarray], mine, twin) -> dict[str, np.ndarray]:
    """Images and gradients of both; `mine` and `twin` make planes of tensors, the latter also marks the undecided pixels."""
    ours = [torch.tensor(given[name], requires_grad=True) for name in names]
    twins = [torch.tensor(given[name].astype(np.float64), requires_grad=True) for name in names]
    image, (expected, undecided) = mine(ours), twin(twins)
    weights = torch.tensor(np.random.default_rng(1).normal(size=expected.shape)) * ~undecided
    (expected * weights).sum().backward()
    (image * weights.float()).sum().backward()
    kept = {"image": image.detach().numpy(), "expected": expected.detach().numpy(), "decided": ~undecided.numpy()}
    for name, tensor, other in zip(names, ours, twins, strict=True):
        kept |= {f"gradient_{name}": tensor.grad.numpy(), f"expected_{name}": other.grad.numpy()}
    return kept


def surfels(given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Surfels of a view, and a short training of others."""
    from helpers import few_primitives
    from surfel_reference import render_reference
    from zeroshop_steps.surface.twodgs.render import RenderView, render
    from zeroshop_steps.surface.twodgs.renderers import make_renderer

    width_px, height_px = (int(value) for value in given["size_px"])
    view = RenderView(given["camera"], width_px, height_px, given["tile_active"], float(given["near"]), tuple(given["depth_map"].tolist()))

    def mine(tensors: list[torch.Tensor]) -> torch.Tensor:
        r = render(*tensors, 3, view, distortion=True, renderer=make_renderer("cuda"))
        return torch.cat([r.color, r.depth[None], r.normal, r.alpha[None], r.median_depth[None], r.distortion[None]])

    def twin(tensors: list[torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
        return render_reference(*tensors, 3, torch.tensor(view.camera), width_px, height_px, view.near, view.depth_map)

    return compare(SURFEL_TENSORS, given, mine, twin) | few_primitives.trained(few_primitives.make_surfel_trainer("cuda"))


def voxels(given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Voxels of a view, each one's largest blending weight and priority, and a short training of others."""
    from helpers import few_primitives
    from voxel_reference import render_reference
    from zeroshop_steps.geometry.cameras.pinhole import Camera
    from zeroshop_steps.surface.svraster.octree import Octree
    from zeroshop_steps.surface.svraster.render import RenderView, render
    from zeroshop_steps.surface.svraster.renderers import make_renderer

    width_px, height_px = (int(value) for value in given["size_px"])
    camera = Camera("view", width_px, height_px, given["intrinsics"], given["camera_from_world"])
    octree, view, drawn, segments = Octree(given["origins"], given["levels"]), RenderView.from_camera(camera), [], {}

    def mine(tensors: list[torch.Tensor]) -> torch.Tensor:
        r = render(octree, *tensors, 3, view, make_renderer("cuda"))
        drawn.append(r)
        return torch.cat([r.color, r.depth[None], r.normal, *(p[None] for p in (r.alpha, r.median_depth, r.color_square, r.away))])

    def twin(tensors: list[torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
        return render_reference(octree, *tensors, 3, torch.tensor(view.camera), width_px, height_px, view.near, segments)

    kept = compare(VOXEL_TENSORS, given, mine, twin)
    left = torch.exp(-segments["thickness"].detach())
    kept["expected_priority"] = ((1 - left) * segments["thickness"].grad / left.clamp(min=1e-4)).abs().sum(1).numpy()
    kept["expected_weight"] = segments["weight"].amax(1).numpy()
    kept |= few_primitives.trained(few_primitives.make_voxel_trainer("cuda"))
    return kept | {"priority": drawn[0].statistics.priority, "weight": drawn[0].statistics.weight}


if __name__ == "__main__":
    name, source, out = sys.argv[1:]
    use_losses_of_a_device()
    np.savez(out, **{"surfels": surfels, "voxels": voxels}[name](dict(np.load(source))))
