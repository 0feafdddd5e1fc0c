"""Poses as the networks move them."""

import torch
from torch import Tensor

from zeroshop_steps.networks.foundationpose.settings import LARGEST_TURN_RAD


def apply_update(camera_from_model: Tensor, translation: Tensor, turn: Tensor, diameter_mm: float) -> Tensor:
    """Poses moved as the refiner says: (N, 4, 4) camera_from_model in mm, of a model whose origin is its centre.

    Translation and rotation are apart: the model turns about its own centre (section 3.3 of the paper).

    Args:
        camera_from_model: (N, 4, 4).
        translation: (N, 3) in radii of the model.
        turn: (N, 3) axis times angle before the hyperbolic tangent. The published refiner turns against the axis: it was trained
            with the transposed rotation.
        diameter_mm: of the model.
    """
    x, y, z = (LARGEST_TURN_RAD * torch.tanh(turn)).unbind(1)
    zero = torch.zeros_like(x)
    against = torch.stack([zero, z, -y, -z, zero, x, y, -x, zero], dim=1).view(-1, 3, 3)
    moved = camera_from_model.clone()
    with torch.autocast(moved.device.type, enabled=False):  # the networks may run in half precision, poses may not
        moved[:, :3, :3] = torch.linalg.matrix_exp(against) @ camera_from_model[:, :3, :3]
    moved[:, :3, 3] += translation * (diameter_mm / 2)
    return moved
