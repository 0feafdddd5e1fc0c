"""Rasterize one mesh at many poses at once: compiled on the processor, in PyTorch on a CUDA device.

For single large pictures and rays, `mesh_rendering.MeshRenderer` is there.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from zeroshop_steps.geometry.rendering.rasterization_kernel import draw_faces, find_shares

NEAREST = 1e-3
"""Faces with a corner closer to the camera plane than this, in the mesh's unit, are not drawn."""
MOST_TRIANGLES = 1 << 19
"""Posed triangles that are set up together, and pixels that triangles drawn together may cover."""


@dataclass(frozen=True)
class PixelGrid:
    """Where the rays of P pictures pass at unit depth: pixel (row, column) looks along (first + step * (column, row), 1).

    Attributes:
        first: (P, 2) x and y of the centre of pixel (0, 0).
        step: (P, 2) from one pixel to the next, positive.
        height_px, width_px: of every picture.
    """

    first: Tensor
    step: Tensor
    height_px: int
    width_px: int

    def slopes(self) -> Tensor:
        """(P, height, width, 2) x and y of every ray at unit depth."""
        columns = torch.arange(self.width_px, device=self.first.device) * self.step[:, :1] + self.first[:, :1]
        rows = torch.arange(self.height_px, device=self.first.device) * self.step[:, 1:] + self.first[:, 1:]
        shape = (len(self.first), self.height_px, self.width_px)
        return torch.stack([columns[:, None, :].expand(shape), rows[:, :, None].expand(shape)], dim=3)


@dataclass(frozen=True)
class Fragments:
    """What P pictures of H x W pixels show.

    Attributes:
        face: (P, H, W) int64 face index, -1 where there is none.
        shares: (P, H, W, 3) weights of the face's corners, 0 where there is none.
    """

    face: Tensor
    shares: Tensor

    def interpolate(self, values: Tensor, faces: Tensor) -> Tensor:
        """(P, H, W, C) values between the corners, 0 where there is no face.

        Args:
            values: of the vertices, (V, C) for all pictures or (P, V, C).
            faces: (F, 3) vertex indices.
        """
        drawn = self.face >= 0
        corners, shares = faces[self.face[drawn]], self.shares[drawn]
        if values.ndim == 3:
            corners = corners + (torch.nonzero(drawn)[:, :1] * values.shape[1])
        of_vertices = values.flatten(0, -2)
        out = torch.zeros((*self.face.shape, values.shape[-1]), dtype=values.dtype, device=values.device)
        out[drawn] = sum((of_vertices[corners[:, k]] * shares[:, k, None] for k in (1, 2)), of_vertices[corners[:, 0]] * shares[:, :1])
        return out


def rasterize(points: Tensor, faces: Tensor, grid: PixelGrid) -> Fragments:
    """Draw the faces, both sides of them, the nearest in front.

    Shares are linear on the surface, not in the picture (Blinn 1992, Hyperbolic Interpolation). Of faces at the same depth, the
    first is drawn.

    Args:
        points: (P, V, 3) vertices in the camera frames (x right, y down, z forward).
        faces: (F, 3) int64 vertex indices.
        grid: the pixels.
    """
    depth = points[..., 2].contiguous()
    pixels = (points[..., :2] / depth.clamp(min=NEAREST)[..., None] - grid.first[:, None]) / grid.step[:, None]
    if points.device.type != "cpu":
        return draw_in_parts(pixels, depth, faces, grid)
    shape = (len(points), grid.height_px, grid.width_px)
    arrays = (pixels.contiguous().numpy(), depth.numpy(), faces.numpy())
    shares = np.empty((*shape, 3), np.float32)
    _, face = draw_faces(*arrays, NEAREST, shape)
    find_shares(*arrays, face, shares)
    return Fragments(torch.from_numpy(face).long(), torch.from_numpy(shares))


def draw_in_parts(pixels: Tensor, depth: Tensor, faces: Tensor, grid: PixelGrid) -> Fragments:
    """What `rasterize` does, on any device, as many pictures at a time as memory allows.

    Args:
        pixels: (P, V, 2) columns and rows of the vertices, and `depth`: (P, V).
        faces: (F, 3).
        grid: the pixels.
    """
    together = max(1, MOST_TRIANGLES // max(len(faces), 1))
    found = [_draw_some(*part, faces, grid) for part in zip(pixels.split(together), depth.split(together), strict=True)]
    return Fragments(torch.cat([one.face for one in found]), torch.cat([one.shares for one in found]))


def _draw_some(pixels: Tensor, depth: Tensor, faces: Tensor, grid: PixelGrid) -> Fragments:
    corners = pixels[:, faces].flatten(0, 1)  # (P * F, 3, 2) columns and rows
    depths = depth[:, faces].flatten(0, 1)
    last = torch.tensor([grid.width_px - 1, grid.height_px - 1], device=pixels.device)
    low = corners.amin(1).ceil().clamp(min=0).minimum(last + 1.0).long()
    high = corners.amax(1).floor().clamp(min=-1).minimum(last.float()).long()
    sides = (high - low + 1).clamp(min=0) * (depths.amin(1) > NEAREST)[:, None]
    shown = torch.nonzero(sides.prod(1)).squeeze(1)
    shape = (len(pixels), grid.height_px, grid.width_px)
    nearest = torch.full(shape, torch.iinfo(torch.int64).max, device=pixels.device)
    ends = sides[shown].prod(1).cumsum(0)
    start, done = 0, 0
    while start < len(shown):
        stop = max(start + 1, int(torch.searchsorted(ends, done + MOST_TRIANGLES, right=True)))
        _draw(shown[start:stop], corners, depths, low, sides, len(faces), grid, nearest.view(-1))
        start, done = stop, int(ends[stop - 1])
    return _read_out(nearest, corners, depths, len(faces))


def _draw(
    triangles: Tensor, corners: Tensor, depths: Tensor, low: Tensor, sides: Tensor, faces: int, grid: PixelGrid, nearest: Tensor
) -> None:
    """Note in `nearest`, one number a pixel, the least pair of depth and face of these triangles and those noted before."""
    sizes = sides[triangles]
    counts = sizes.prod(1)
    owner = torch.repeat_interleave(counts)
    place = torch.arange(len(owner), device=owner.device) - (counts.cumsum(0) - counts)[owner]
    triangle, width = triangles[owner], sizes[owner, 0]
    column, row = low[triangle, 0] + place % width, low[triangle, 1] + place // width
    shares, depth = _find_shares(corners[triangle], depths[triangle], torch.stack([column, row], dim=1).to(corners.dtype))
    inside = (shares >= 0).all(1) & depth.isfinite()
    pixel = (triangle // faces * grid.height_px + row) * grid.width_px + column
    key = (depth.view(torch.int32).long() << 32) | triangle % faces  # positive floats are ordered as their bits are
    nearest.scatter_reduce_(0, pixel[inside], key[inside], "amin")


def _find_shares(corners: Tensor, depths: Tensor, pixel: Tensor) -> tuple[Tensor, Tensor]:
    """(N, 3) shares of the corners on the surface at a pixel, one negative outside, and (N,) the depth there."""
    away = corners - pixel[:, None]
    following = away.roll(-1, 1)
    edges = (away[..., 0] * following[..., 1] - away[..., 1] * following[..., 0]).roll(-1, 1)  # the one opposite of each corner
    weights = edges / edges.sum(1, keepdim=True) / depths
    inverse_depth = weights.sum(1)
    return weights / inverse_depth[:, None], 1.0 / inverse_depth


def _read_out(nearest: Tensor, corners: Tensor, depths: Tensor, faces: int) -> Fragments:
    """The fragments that `nearest` (P, H, W) names."""
    drawn = nearest != torch.iinfo(torch.int64).max
    face = torch.where(drawn, nearest & 0xFFFFFFFF, -1)
    picture, row, column = torch.nonzero(drawn, as_tuple=True)
    triangle = picture * faces + face[drawn]
    shares = torch.zeros((*nearest.shape, 3), dtype=corners.dtype, device=corners.device)
    shares[drawn] = _find_shares(corners[triangle], depths[triangle], torch.stack([column, row], dim=1).to(corners.dtype))[0]
    return Fragments(face, shares)
