"""The lists of `tiles` from tensors, on any device."""

import torch

from zeroshop_steps.surface.rendering.sorted_lists import invert_order, sort_into_groups


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
    rank = invert_order(torch.sort(depths, stable=True).indices)
    shown = torch.nonzero(blocks).flatten()
    starts, order = sort_into_groups(tile_of[shown].long(), rank[splat_of[shown].long()], max(len(depths), 1), tiles)
    slot_of = shown[order]
    return starts, splat_of[slot_of], slot_of.int()
