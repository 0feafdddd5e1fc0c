"""Matches of two pictures from their local features (Leroy et al., MASt3R, ECCV 2024, section 3.3)."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from zeroshop_steps.networks.mast3r.model import ImagePrediction

SUBSAMPLING = 8  # pixels from one start of a match to the next
TILE = {"cpu": (64, 1 << 14), "cuda": (1 << 12, 1 << 15)}
"""Queries and features that are compared at a time: what a processor's cache holds, or what keeps a GPU busy."""


@dataclass(frozen=True)
class Matches:
    """Pixels of two pictures that show the same point.

    Attributes:
        first, second: (M, 2) int64 columns and rows in the network's pictures.
        confidence: (M,) the smaller of both features'.
    """

    first: np.ndarray
    second: np.ndarray
    confidence: np.ndarray


def match_pair(first: ImagePrediction, second: ImagePrediction, min_confidence: float, subsampling: int = SUBSAMPLING) -> Matches:
    """Match the pictures of one pair (B is 1), from a grid of starts in either.

    Args:
        first, second: what the network says of them.
        min_confidence: of the features of a match.
        subsampling: pixels from one start to the next.
    """
    features = [side.descriptors[0].flatten(0, 1) for side in (first, second)]
    confidences = [side.descriptor_confidence[0].flatten() for side in (first, second)]
    sizes = [(side.descriptors.shape[1], side.descriptors.shape[2]) for side in (first, second)]
    there = find_reciprocal(features[0], features[1], make_start_grid(*sizes[0], subsampling, features[0].device))
    back = find_reciprocal(features[1], features[0], make_start_grid(*sizes[1], subsampling, features[0].device)).flip(1)
    pairs = torch.unique(torch.cat([there, back]), dim=0)
    confidence = torch.minimum(confidences[0][pairs[:, 0]], confidences[1][pairs[:, 1]])
    kept = confidence >= min_confidence
    found = pairs[kept].cpu().numpy()
    places = [np.stack([found[:, side] % sizes[side][1], found[:, side] // sizes[side][1]], axis=1) for side in (0, 1)]
    return Matches(places[0], places[1], confidence[kept].float().cpu().numpy())


def make_start_grid(height: int, width: int, subsampling: int, device: torch.device | str = "cpu") -> Tensor:
    """The flat indices of a grid of pixels."""
    rows = torch.arange(subsampling // 2, height, subsampling, device=device)
    columns = torch.arange(subsampling // 2, width, subsampling, device=device)
    return (rows[:, None] * width + columns).flatten()


def find_reciprocal(first: Tensor, second: Tensor, at: Tensor, rounds: int = 10) -> Tensor:
    """Go from features `at` of the first to their nearest of the second and back until the way there and back is the same.

    Args:
        first, second: (P, D) and (Q, D) unit vectors.
        at: (S,) indices into `first`.
        rounds: after so many, what has not come to rest is given up.

    Returns:
        (M, 2) mutual nearest neighbours, each once.
    """
    found = []
    for _ in range(rounds):
        if not len(at):
            break
        over = find_nearest(first[at], second)
        back = find_nearest(second[over], first)
        rests = back == at
        found.append(torch.stack([at[rests], over[rests]], dim=1))
        at = torch.unique(back[~rests])
    return torch.unique(torch.cat(found), dim=0) if found else torch.zeros((0, 2), dtype=torch.int64, device=first.device)


def find_nearest(queries: Tensor, features: Tensor) -> Tensor:
    """(S,) index of the most similar of (Q, D) features for each of (S, D) queries."""
    rows, columns = TILE[features.device.type]
    parts = [part.T.contiguous() for part in features.split(columns)]
    found = [torch.zeros(0, dtype=torch.int64, device=features.device)]
    buffer = torch.empty((rows, columns), dtype=features.dtype, device=features.device)
    for some in queries.split(rows):
        best = torch.full((len(some),), -torch.inf, dtype=features.dtype, device=features.device)
        at = torch.zeros(len(some), dtype=torch.int64, device=features.device)
        for number, part in enumerate(parts):
            similar = torch.mm(some, part, out=buffer.flatten()[: len(some) * part.shape[1]].view(len(some), -1))
            value, place = similar.max(dim=1)
            better = value > best
            best, at = torch.where(better, value, best), torch.where(better, place + number * columns, at)
        found.append(at)
    return torch.cat(found)
