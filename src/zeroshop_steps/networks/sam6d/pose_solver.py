"""Poses from likenesses of points: hypotheses of three pairs each, and the least-squares pose of all pairs."""

import torch
import torch.nn.functional as F
from torch import Tensor

from zeroshop_steps.networks.sam6d.points import measure_square_distances

NEAR = 0.15  # of the object's radius: a point that is this near to the model after the pose speaks for it
AT_ONCE = 60  # hypotheses that are compared with the model at a time, which bounds the memory


def fit_poses(source: Tensor, target: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """(B, 3, 3) and (B, 3) target_from_source of (B, N, 3) pairs of points, by weighted least squares (Kabsch 1976).

    Args:
        source, target: the points.
        weights: (B, N); all alike by default.
    """
    weights = torch.ones_like(source[..., 0]) if weights is None else weights
    weights = (weights / (weights.sum(1, keepdim=True) + 1e-5))[..., None]
    source_middle, target_middle = (source * weights).sum(1, keepdim=True), (target * weights).sum(1, keepdim=True)
    left, _, right = torch.linalg.svd((source - source_middle).transpose(1, 2) @ (weights * (target - target_middle)))
    mirrored = torch.linalg.det(right.transpose(1, 2) @ left.transpose(1, 2)).sign()
    signs = torch.stack([torch.ones_like(mirrored), torch.ones_like(mirrored), mirrored], 1)
    rotations = (right.transpose(1, 2) * signs[:, None]) @ left.transpose(1, 2)
    return rotations, (target_middle.transpose(1, 2) - rotations @ source_middle.transpose(1, 2))[..., 0]


def assign(logits: Tensor) -> tuple[Tensor, Tensor]:
    """Probabilities of pairs by a softmax in both directions.

    Args:
        logits: (B, 1 + N, 1 + M), the first row and column for none.

    Returns:
        (B, N, M), 0 for points that belong to none; and (B, N) 1 for points of the first cloud that belong to some, 0 for others.
    """
    both = F.softmax(logits, dim=2) * F.softmax(logits, dim=1)
    first, second = (both[:, 1:].argmax(2) > 0).to(both.dtype), (both[:, :, 1:].argmax(1) > 0).to(both.dtype)
    return both[:, 1:, 1:] * first[:, :, None] * second[:, None], first


def find_coarse_pose(logits: Tensor, seen: Tensor, known: Tensor, model: Tensor, draws: Tensor, kept: int) -> tuple[Tensor, Tensor]:
    """The hypothesis after which the seen points lie nearest to the model.

    Args:
        logits: (B, 1 + N, 1 + M).
        seen: (B, N, 3) points of the image.
        known: (B, M, 3) points of the object, in its frame.
        model: (B, P, 3) points on all of its surface.
        draws: (B, 3 H) random numbers, 0..1, that draw the pairs of H hypotheses.
        kept: how many hypotheses, those whose own pairs fit best, are compared with the model.

    Returns:
        (B, 3, 3) and (B, 3) image_from_object.
    """
    probabilities, weights = assign(logits)
    # A power makes likely pairs be drawn more often.
    chances = (probabilities.flatten(1) ** 1.5).cumsum(1)
    drawn = torch.searchsorted(chances / (chances[:, -1:] + 1e-8), draws).clamp(max=chances.shape[1] - 1)
    batch, count = len(seen), draws.shape[1] // 3
    triples = [
        points.gather(1, indices[..., None].expand(-1, -1, 3)).view(batch * count, 3, 3)
        for points, indices in ((seen, drawn // known.shape[1]), (known, drawn % known.shape[1]))
    ]
    rotations, places = fit_poses(triples[1], triples[0])
    off = ((triples[0] - places[:, None]) @ rotations - triples[1]).norm(dim=2).mean(1).view(batch, count)
    best = off.topk(min(kept, count), dim=1, largest=False).indices
    rotations = rotations.view(batch, count, 3, 3).gather(1, best[..., None, None].expand(-1, -1, 3, 3))
    places = places.view(batch, count, 3).gather(1, best[..., None].expand(-1, -1, 3))
    scores = torch.cat(
        [
            _score_by_model(seen, some_rotations, some_places, model, weights)
            for some_rotations, some_places in zip(rotations.split(AT_ONCE, 1), places.split(AT_ONCE, 1), strict=True)
        ],
        1,
    )
    winner = scores.argmax(1)
    each = torch.arange(batch, device=seen.device)
    return rotations[each, winner], places[each, winner]


def find_fine_pose(logits: Tensor, seen: Tensor, known: Tensor, model: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The pose that all pairs fit best, and its score; arguments as in `find_coarse_pose`.

    Returns:
        (B, 3, 3) and (B, 3) image_from_object, and (B,) scores, 0..1: the share of the seen points that belong to the object and lie near
        the model.
    """
    probabilities, belongs = assign(logits)
    expected = probabilities / (probabilities.sum(2, keepdim=True) + 1e-6) @ known
    rotations, places = fit_poses(expected, seen, probabilities.sum(2))
    near = measure_square_distances((seen - places[:, None]) @ rotations, model).amin(2).sqrt() < NEAR
    scores = (near * belongs).sum(1) / (belongs.sum(1) + 1e-8) * belongs.mean(1)
    return rotations, places, scores


def _score_by_model(seen: Tensor, rotations: Tensor, places: Tensor, model: Tensor, weights: Tensor) -> Tensor:
    """(B, H) inverse mean distances to the model, (B, P, 3), of the seen points that belong to it, after (B, H) poses."""
    moved = (seen[:, None] - places[:, :, None]) @ rotations
    off = measure_square_distances(moved, model[:, None]).amin(3).sqrt()
    return weights.sum(1, keepdim=True) / ((off * weights[:, None]).sum(2) + 1e-8)
