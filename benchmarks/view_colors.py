"""Colour that changes with the viewing direction, differentiable: what the kernels of the renderers must agree with."""

import torch

from zeroshop_steps.surface.rendering.spherical_harmonics import _C1, _C2, _C3, SH_CONSTANT


def spherical_harmonics(directions: torch.Tensor) -> torch.Tensor:
    """(N, 3) unit directions to (N, 16) real spherical harmonics of degree 0 to 3."""
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    basis = [torch.full_like(x, SH_CONSTANT), -_C1 * y, _C1 * z, -_C1 * x]
    basis += [_C2[0] * x * y, _C2[1] * y * z, _C2[2] * (2 * zz - xx - yy), _C2[3] * x * z, _C2[4] * (xx - yy)]
    basis += [_C3[0] * y * (3 * xx - yy), _C3[1] * x * y * z, _C3[2] * y * (4 * zz - xx - yy), _C3[3] * z * (2 * zz - 3 * xx - 3 * yy)]
    basis += [_C3[4] * x * (4 * zz - xx - yy), _C3[5] * z * (xx - yy), _C3[6] * x * (xx - 3 * yy)]
    return torch.stack(basis, -1)
