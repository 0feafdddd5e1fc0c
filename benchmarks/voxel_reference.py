"""Sparse voxels in a few lines of differentiable PyTorch: what the kernels must agree with.

It follows the paper rather than the kernels (Sun et al. 2025, sec. 3.1): every pixel's ray is cut with every voxel's box in
world coordinates, corner values are interpolated with the eight trilinear weights, the segments are sorted by their
depth, ray by ray, and autograd gives the gradients. It is slow, and for tests only.
"""

import torch

from view_colors import spherical_harmonics
from zeroshop_steps.surface.rendering.tiling import STOP
from zeroshop_steps.surface.svraster.kernels.intersection import DENSITY_SCALE, LINEAR_FROM, SAMPLES
from zeroshop_steps.surface.svraster.kernels.project import FLAT
from zeroshop_steps.surface.svraster.octree import CORNER_OFFSETS, Octree


def activate(value: torch.Tensor) -> torch.Tensor:
    """Exponential-linear activation (eq. 3)."""
    return torch.where(value > LINEAR_FROM, value, LINEAR_FROM * torch.exp(value.clamp(max=LINEAR_FROM) / LINEAR_FROM - 1))


def render_reference(
    octree: Octree, densities: torch.Tensor, sh: torch.Tensor, degree: int, camera: torch.Tensor, width_px: int, height_px: int,
    near: float, kept: dict[str, torch.Tensor] | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
    """The eleven planes colour (3), depth, normal (3), opacity, median depth, squared colour and away as (11, height, width).

    The second result, (height, width) bool, marks pixels where some decision (light spent or not, which voxel holds the median)
    is so close that single precision may rightly decide otherwise. densities (M,) and sh (N, K, 3) as in `render.render`;
    camera (16,) as in `project.project_forward`. `kept` is given the optical thickness of each voxel along each ray, (N, P), which keeps
    its gradient, and its blending weight.
    """
    rotation, translation = camera[:9].reshape(3, 3), camera[9:12]
    fx, fy, cx, cy = camera[12:16]
    origin = -rotation.T @ translation
    centres, sizes = torch.from_numpy(octree.centres).to(camera), torch.from_numpy(octree.sizes).to(camera)
    offsets = torch.from_numpy(CORNER_OFFSETS).to(camera)
    corner_values = densities[torch.from_numpy(octree.corners).long()]
    gradient = torch.einsum("nc,ca->na", corner_values, 2 * offsets - 1) / 4
    normals = -(gradient / (gradient.square().sum(1, keepdim=True) + FLAT).sqrt()) @ rotation.T
    direction = torch.nn.functional.normalize(centres - origin, dim=-1)
    coefficients = (degree + 1) ** 2
    colors = (torch.einsum("nk,nkc->nc", spherical_harmonics(direction)[:, :coefficients], sh[:, :coefficients]) + 0.5).clamp(min=0)

    ys, xs = torch.meshgrid(torch.arange(height_px) + 0.5, torch.arange(width_px) + 0.5, indexing="ij")
    xs, ys = xs.reshape(-1).to(camera), ys.reshape(-1).to(camera)
    in_camera = torch.stack([(xs - cx) / fx, (ys - cy) / fy, torch.ones_like(xs)], 1)
    rays = in_camera @ rotation
    low = (centres - 0.5 * sizes[:, None] - origin)[:, None] / rays
    high = (centres + 0.5 * sizes[:, None] - origin)[:, None] / rays
    entry = torch.minimum(low, high).amax(-1).clamp(min=near)
    length = (torch.maximum(low, high).amin(-1) - entry).clamp(min=0)
    thickness = torch.zeros_like(length)
    for k in range(SAMPLES):
        points = origin + (entry + length * (k + 0.5) / SAMPLES)[..., None] * rays
        local = (points - centres[:, None]) / sizes[:, None, None] + 0.5
        weights = torch.where(offsets[:, None, None] > 0, local, 1 - local).prod(-1)
        thickness = thickness + activate(torch.einsum("cnp,nc->np", weights, corner_values))
    thickness = thickness * length * rays.norm(dim=1) * DENSITY_SCALE / SAMPLES
    if kept is not None:
        thickness.retain_grad()
        kept["thickness"] = thickness

    order = torch.argsort(torch.where(length > 0, entry, torch.inf), dim=0)

    def sorted_(values: torch.Tensor) -> torch.Tensor:
        return torch.gather(values.expand(len(centres), len(rays)), 0, order)

    thickness, entry, length = sorted_(thickness), sorted_(entry), sorted_(length)
    after = thickness.cumsum(0)
    before = after - thickness
    lit = torch.exp(-before) >= float(STOP)
    weight = torch.where(lit, torch.exp(-before) * (1 - torch.exp(-thickness)), 0.0)
    if kept is not None:
        kept["weight"] = torch.zeros_like(weight).scatter(0, order, weight).detach()
    facing = (normals @ in_camera.T) / rays.norm(dim=1)
    values = [colors[:, :1], colors[:, 1:2], colors[:, 2:], None, *normals.T[:, :, None], torch.ones(len(centres), 1)]
    planes = [(weight * (sorted_(value) if value is not None else entry + 0.5 * length)).sum(0) for value in values]
    half = torch.log(torch.tensor(2.0, dtype=camera.dtype))
    crosses = (before < half) & (after >= half)
    median = torch.where(crosses, entry + length * (half - before) / thickness.clamp(min=1e-30), 0.0).sum(0)
    planes += [median, (weight * sorted_(colors.square().sum(1, keepdim=True))).sum(0), (weight * sorted_(facing.clamp(min=0))).sum(0)]
    cut = (((torch.exp(-before) / float(STOP) - 1).abs() < 1e-2) & (thickness > 0)).any(0)
    # Where a voxel is seen from its edge, the kink of what faces away lies within single precision.
    edge_on = ((sorted_(facing).abs() < 1e-4) & (weight > 0)).any(0)
    undecided = cut | edge_on | (((after - half).abs() < 1e-4) & (thickness > 0)).any(0)
    return torch.stack(planes).reshape(11, height_px, width_px), undecided.reshape(height_px, width_px)
