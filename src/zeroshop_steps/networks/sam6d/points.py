"""Operations on clouds of points that PointNet++ has in CUDA, in plain PyTorch."""

import torch
from torch import Tensor


def sample_farthest(points: Tensor, count: int) -> Tensor:
    """(B, count) indices of (B, N, 3) points: the first, then always the one that is farthest from all those before."""
    chosen = torch.zeros(len(points), count, dtype=torch.long, device=points.device)
    nearest = torch.full(points.shape[:2], torch.inf, device=points.device)
    for step in range(1, count):
        last = points.gather(1, chosen[:, step - 1, None, None].expand(-1, -1, 3))
        nearest = torch.minimum(nearest, (points - last).square().sum(2))
        chosen[:, step] = nearest.argmax(1)
    return chosen


def take(values: Tensor, indices: Tensor) -> Tensor:
    """(B, M, C) of (B, N, C) values by (B, M) indices."""
    return values.gather(1, indices[..., None].expand(-1, -1, values.shape[2]))


def find_in_balls(points: Tensor, radius: float, count: int) -> Tensor:
    """(B, N, count) indices of points within a radius of each of (B, N, 3) points: the first ones, and where there are fewer, the first
    again."""
    apart = points[:, :, None] - points[:, None]
    inside = (apart[..., 0].square() + apart[..., 1].square()) + apart[..., 2].square() < radius**2
    number = torch.arange(points.shape[1], device=points.device).expand_as(inside)
    found = torch.where(inside, number, points.shape[1]).topk(min(count, points.shape[1]), largest=False).values.sort(2).values
    found = torch.where(found < points.shape[1], found, found[..., :1])
    return torch.cat([found, found[..., :1].expand(-1, -1, count - found.shape[2])], 2)


def measure_square_distances(first: Tensor, second: Tensor) -> Tensor:
    """(..., N, M) squared distances of (..., N, 3) and (..., M, 3) points, as a^2 - 2ab + b^2.

    The published network was trained with the rounding errors of this formula, which its embedding of distances amplifies.
    """
    products = first @ second.transpose(-1, -2)
    squares, other_squares = first.square().sum(-1)[..., None], second.square().sum(-1)[..., None, :]
    return (squares - 2 * products + other_squares).clamp(min=0)
