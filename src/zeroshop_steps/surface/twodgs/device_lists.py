"""The lists of `tiles` from tensors, on any device: what each tile shows, front to back, by sorting."""

import torch


def list_slots_by_tile(
    depths: torch.Tensor, blocks: torch.Tensor, tile_of: torch.Tensor, splat_of: torch.Tensor, tiles: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Sort the slots that show something into tiles; those of one tile by depth, and equal depths by number.

    Args:
        depths: (N,) float32 of the splats' centres.
        blocks, tile_of, splat_of: (S,) int32 of each slot: the blocks that are seen, none in tiles that are not drawn, its tile and splat.
        tiles: their number.

    Returns:
        starts (tiles + 1,) int64, splat_of and slot_of (I,) int32, as `tiles.TileLists` has them.
    """
    count = max(len(depths), 1)
    order = torch.sort(depths, stable=True).indices
    rank = torch.empty_like(order)
    rank[order] = torch.arange(len(order), device=order.device)
    shown = torch.nonzero(blocks).flatten()
    # No two keys are equal, so that there is one order.
    keys, order = torch.sort(tile_of[shown].long() * count + rank[splat_of[shown].long()])
    starts = torch.searchsorted(keys, torch.arange(tiles + 1, device=keys.device) * count)
    slot_of = shown[order]
    return starts, splat_of[slot_of], slot_of.int()
