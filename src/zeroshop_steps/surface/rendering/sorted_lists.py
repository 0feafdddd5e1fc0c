"""Lists of what each tile shows, front to back, from tensors on any device: by sorting."""

import torch


def sort_into_groups(group_of: torch.Tensor, rank_of: torch.Tensor, ranks: int, groups: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Sort entries by their groups, and by rank within each.

    Args:
        group_of, rank_of: (E,) int64 of each entry, below `groups` and `ranks`. No two entries of a group have the same rank, so that
            there is one order.

    Returns:
        starts: (groups + 1,) int64, where each group begins.
        order: (E,) int64, the entries in order.
    """
    keys, order = torch.sort(group_of * ranks + rank_of)
    return torch.searchsorted(keys, torch.arange(groups + 1, device=keys.device) * ranks), order


def invert_order(order: torch.Tensor) -> torch.Tensor:
    """(..., N) the place of each number in (..., N) permutations of them."""
    return torch.empty_like(order).scatter_(-1, order, torch.arange(order.shape[-1], device=order.device).expand_as(order))
