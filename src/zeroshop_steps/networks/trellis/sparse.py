"""Sparse voxels: convolution at the voxels that are there, pooling, subdivision, and attention within windows.

A set of voxels is (N, 3) whole coordinates, in any order; its features are (N, channels). Everything here is gathers and matrix
products, so it runs wherever PyTorch does, and gives the same bytes each time.
"""

from dataclasses import dataclass, field

import torch
import torch.nn.functional as F
from torch import Tensor, nn

CHUNK_VALUES = 1 << 25
"""Values that a convolution, or an attention, gathers at once: 134 MB."""
BASE = 1 << 20
"""Larger than any coordinate, so that a voxel is one whole number."""


def voxel_keys(coordinates: Tensor) -> Tensor:
    """(N,) int64: one number for each (N, 3) voxel, in the order of the coordinates; these are at least -1."""
    x, y, z = (coordinates.long() + 1).unbind(1)
    return (x * BASE + y) * BASE + z


@dataclass(frozen=True)
class SparseVoxels:
    """Places of voxels, and what is known of their neighbourhood once it was asked for.

    Attributes:
        coordinates: (N, 3) int64, none twice.
    """

    coordinates: Tensor
    _tables: dict[str, Tensor] = field(default_factory=dict, repr=False, compare=False)

    def neighbours(self) -> Tensor:
        """(N, 27) int32 index of the voxel at each offset of -1 to 1, the last axis fastest; N where there is none."""
        if "neighbours" not in self._tables:
            keys, order = voxel_keys(self.coordinates).sort()
            count = len(keys)
            table = torch.empty((count, 27), dtype=torch.int32, device=keys.device)
            offsets = torch.cartesian_prod(*[torch.arange(-1, 2, device=keys.device)] * 3)
            for place, offset in enumerate(offsets):
                wanted = voxel_keys(self.coordinates + offset)
                found = torch.searchsorted(keys, wanted).clamp(max=count - 1)
                table[:, place] = torch.where(keys[found] == wanted, order[found], count).int()
            self._tables["neighbours"] = table
        return self._tables["neighbours"]


class SubmanifoldConvolution(nn.Module):
    """Convolution that is evaluated only where voxels are, and sees only voxels (Graham et al. 2018).

    Its parameters are those of spconv: `conv.weight` (out, k, k, k, in), with k of 1 or 3.
    """

    def __init__(self, channels: int, out_channels: int, size: int = 3) -> None:
        super().__init__()
        self.conv = _ConvolutionParameters(channels, out_channels, size)

    def forward(self, x: Tensor, voxels: SparseVoxels) -> Tensor:
        weight, bias = self.conv.weight.flatten(1), self.conv.bias
        if self.conv.weight.shape[1] == 1:
            # spconv reads its weights of one voxel as (in, out), against their shape, and so they were trained.
            return F.linear(x, weight.reshape(weight.shape[::-1]).T, bias)
        padded = torch.cat([x, x.new_zeros(1, x.shape[1])])
        rows = max(1, CHUNK_VALUES // weight.shape[1])
        parts = [
            F.linear(padded.index_select(0, part.flatten()).reshape(len(part), -1), weight, bias)
            for part in voxels.neighbours().split(rows)
        ]
        return torch.cat(parts)


class _ConvolutionParameters(nn.Module):
    def __init__(self, channels: int, out_channels: int, size: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(out_channels, size, size, size, channels))
        self.bias = nn.Parameter(torch.empty(out_channels))


@dataclass(frozen=True)
class Pooling:
    """Voxels joined two by two along each axis.

    Attributes:
        coarse: the joined voxels.
        index: (N,) for each fine voxel, the coarse one that it is in.
    """

    coarse: SparseVoxels
    index: Tensor

    @staticmethod
    def of(voxels: SparseVoxels) -> "Pooling":
        """Join these voxels."""
        keys, index = voxel_keys(voxels.coordinates // 2).unique(return_inverse=True)
        coordinates = torch.stack([keys // BASE**2, keys // BASE % BASE, keys % BASE], 1) - 1
        return Pooling(SparseVoxels(coordinates), index)

    def average(self, x: Tensor) -> Tensor:
        """(M, channels) sums over the joined voxels, divided by one more than their number, as the flow was trained."""
        count = len(self.coarse.coordinates)
        sums = x.new_zeros(count, x.shape[1]).index_add_(0, self.index, x)
        return sums / (1 + torch.bincount(self.index, minlength=count))[:, None].to(x.dtype)

    def spread(self, x: Tensor) -> Tensor:
        """(N, channels) of the fine voxels: those of the coarse ones that they are in."""
        return x[self.index]


def subdivide(voxels: SparseVoxels) -> SparseVoxels:
    """Each voxel's eight halves, one after the other, the last axis fastest."""
    corners = torch.cartesian_prod(*[torch.arange(2, device=voxels.coordinates.device)] * 3)
    return SparseVoxels((2 * voxels.coordinates[:, None] + corners).flatten(0, 1))


class WindowAttention:
    """Attention of voxels to those in the same window of a grid (Liu et al. 2021, in three dimensions).

    Windows of nearly the same number of voxels go together, padded to the largest of them.

    Args:
        coordinates: (N, 3) of the voxels.
        window: edge of a window in voxels.
        shift: of the grid of windows.
    """

    def __init__(self, coordinates: Tensor, window: int, shift: int) -> None:
        _, index, sizes = voxel_keys((coordinates + shift) // window).unique(return_inverse=True, return_counts=True)
        order = index.argsort(stable=True)
        first = sizes.cumsum(0) - sizes
        self.groups: list[tuple[Tensor, Tensor]] = []
        largest = int(sizes.max())
        reach = 1
        while reach < 2 * largest:
            chosen = ((sizes > reach // 2) & (sizes <= reach)).nonzero()[:, 0]
            if len(chosen):
                places = torch.arange(int(sizes[chosen].max()), device=coordinates.device)
                real = places < sizes[chosen, None]
                self.groups.append((order[torch.where(real, first[chosen, None] + places, 0)], real))
            reach *= 2

    def __call__(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """(N, heads, width) outputs from queries, keys and values of that shape."""
        out = torch.empty_like(v)
        for members, real in self.groups:
            rows = max(1, CHUNK_VALUES // (members.shape[1] ** 2 * q.shape[1]))
            for part, mask in zip(members.split(rows), real.split(rows), strict=True):
                query, key, value = (x[part].transpose(1, 2) for x in (q, k, v))
                found = F.scaled_dot_product_attention(query, key, value, attn_mask=mask[:, None, None]).transpose(1, 2)
                out[part[mask]] = found[mask].to(out.dtype)
        return out
