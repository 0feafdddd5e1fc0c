"""2D Gaussian Splatting in a few lines of differentiable PyTorch: what the kernels must agree with.

It follows the paper rather than the kernels: the ray-splat intersection is that of two homogeneous planes (Huang et
al. 2024, eq. 8 to 10), every pixel is compared with every surfel, and autograd gives the gradients. It is slow, and for tests only.
"""

import torch

from view_colors import spherical_harmonics
from zeroshop_steps.surface.twodgs.kernels.project import ALPHA_MIN, GRAZING_MIN
from zeroshop_steps.surface.twodgs.surfels import rotation_matrices


def render_reference(
    positions: torch.Tensor, log_scales: torch.Tensor, quaternions: torch.Tensor, opacity_logits: torch.Tensor, sh: torch.Tensor,
    degree: int, camera: torch.Tensor, width_px: int, height_px: int, near: float, depth_map: tuple[float, float],
) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
    """The ten planes colour (3), depth, normal (3), opacity, median depth and distortion as (10, height, width).

    The second result, (height, width) bool, marks pixels where some decision (visible or not, surfel or low-pass filter,
    light spent or not) is so close that single precision may rightly decide otherwise.

    Arguments as in `project.project_forward`; depth_map is (k1, k2) of the distortion term's mapped depth k1 - k2 / z.
    """
    rotation, translation = camera[:9].reshape(3, 3), camera[9:12]
    fx, fy, cx, cy = camera[12:16]
    centres = positions @ rotation.T + translation
    axes = rotation @ rotation_matrices(quaternions)
    scales = log_scales.exp()
    opacity = torch.sigmoid(opacity_logits)
    coefficients = (degree + 1) ** 2
    direction = torch.nn.functional.normalize(positions + rotation.T @ translation, dim=-1)
    colors = (torch.einsum("nk,nkc->nc", spherical_harmonics(direction)[:, :coefficients], sh[:, :coefficients]) + 0.5).clamp(min=0)
    facing = (axes[:, :, 2] * centres).sum(-1)
    normals = torch.where(facing > 0, -1.0, 1.0)[:, None] * axes[:, :, 2]

    # Rows of the splat-to-pixel homography: x z, y z and z as linear functions of (u, v, 1).
    local = torch.stack([axes[:, :, 0] * scales[:, :1], axes[:, :, 1] * scales[:, 1:], centres], -1)
    row_x, row_y, row_w = fx * local[:, 0] + cx * local[:, 2], fy * local[:, 1] + cy * local[:, 2], local[:, 2]

    ys, xs = torch.meshgrid(torch.arange(height_px) + 0.5, torch.arange(width_px) + 0.5, indexing="ij")
    xs, ys = xs.reshape(-1).to(positions), ys.reshape(-1).to(positions)
    light = torch.ones_like(xs)
    planes = [torch.zeros_like(xs) for _ in range(12)]
    undecided = torch.zeros_like(xs, dtype=torch.bool)
    k1, k2 = depth_map
    for i in torch.argsort(centres[:, 2]).tolist():
        if centres[i, 2] <= near or opacity[i] <= ALPHA_MIN:
            continue
        h_u, h_v = xs[:, None] * row_w[i] - row_x[i], ys[:, None] * row_w[i] - row_y[i]
        point = torch.linalg.cross(h_u, h_v)
        usable = (facing[i].abs() > GRAZING_MIN * centres[i, 2]) & (point[:, 2].abs() > 0)
        divisor = torch.where(usable, point[:, 2], torch.ones_like(xs))
        u, v = point[:, 0] / divisor, point[:, 1] / divisor
        z = u * row_w[i, 0] + v * row_w[i, 1] + row_w[i, 2]
        usable = usable & (z > 0) & (z < centres[i, 2] * 1e6)
        rho_surfel = torch.where(usable, u * u + v * v, torch.full_like(xs, 1e30))
        centre_x, centre_y = fx * centres[i, 0] / centres[i, 2] + cx, fy * centres[i, 1] / centres[i, 2] + cy
        rho_pixel = 2.0 * ((xs - centre_x) ** 2 + (ys - centre_y) ** 2)
        z = torch.where(rho_surfel <= rho_pixel, z, centres[i, 2].expand_as(z))
        full = opacity[i] * torch.exp(-0.5 * torch.minimum(rho_surfel, rho_pixel))
        alpha = full.clamp(max=0.99)
        visible = (alpha >= ALPHA_MIN) & (light >= 1e-4)
        close = ((rho_surfel - rho_pixel).abs() < 1e-3 * rho_pixel) | ((light - 0.5).abs() < 1e-5) | ((full - 0.99).abs() < 1e-5)
        undecided |= (visible & close) | ((alpha / ALPHA_MIN - 1).abs() < 1e-3) | ((light / 1e-4 - 1).abs() < 1e-2)
        weight = torch.where(visible, light * alpha, torch.zeros_like(xs))
        values = [*colors[i], z, *normals[i], torch.ones_like(xs)]
        planes[8] = torch.where(visible & (light > 0.5), z, planes[8])
        mapped = k1 - k2 / torch.where(visible, z, torch.ones_like(z))
        planes[9] = planes[9] + weight * (mapped**2 * (1 - light) + planes[11] - 2 * mapped * planes[10])
        planes[10], planes[11] = planes[10] + weight * mapped, planes[11] + weight * mapped**2
        for plane, value in enumerate(values):
            planes[plane] = planes[plane] + weight * value
        light = light - weight
    return torch.stack(planes[:10]).reshape(10, height_px, width_px), undecided.reshape(height_px, width_px)
