"""Rasterize one mesh at many poses at once, by compiled kernels on the processor or on a CUDA device.

For single large pictures and rays, `mesh_rendering.MeshRenderer` is there.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from zeroshop_steps.geometry.rendering.rasterization_kernel import draw_faces, find_shares
from zeroshop_steps.runtime.compute.device_arrays import to_kernel
from zeroshop_steps.runtime.compute.kernel_devices import choose_kernel_device

NEAREST = 1e-3
"""Faces with a corner closer to the camera plane than this, in the mesh's unit, are not drawn."""


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
    pixels, depth = find_pixels(points, grid)
    if points.device.type != "cpu":
        choose_kernel_device("cuda")  # raises where PyTorch finds the device alone
        return draw_on_device(pixels, depth, faces, grid)
    shape = (len(points), grid.height_px, grid.width_px)
    arrays = (pixels.numpy(), depth.numpy(), faces.numpy())
    shares = np.empty((*shape, 3), np.float32)
    _, face = draw_faces(*arrays, NEAREST, shape)
    find_shares(*arrays, face, shares)
    return Fragments(torch.from_numpy(face).long(), torch.from_numpy(shares))


def find_pixels(points: Tensor, grid: PixelGrid) -> tuple[Tensor, Tensor]:
    """(P, V, 2) columns and rows of (P, V, 3) vertices in the camera frames, and their (P, V) depths."""
    depth = points[..., 2].contiguous()
    pixels = (points[..., :2] / depth.clamp(min=NEAREST)[..., None] - grid.first[:, None]) / grid.step[:, None]
    return pixels.contiguous(), depth


def draw_on_device(pixels: Tensor, depth: Tensor, faces: Tensor, grid: PixelGrid) -> Fragments:
    """What `rasterize` does, by kernels for CUDA.

    Args:
        pixels: (P, V, 2) and `depth`: (P, V) what `find_pixels` gives, on the device.
        faces: (F, 3).
        grid: the pixels.
    """
    from zeroshop_steps.geometry.rendering.cuda_rasterization import LAST_FACE, keep_nearest_faces, share_corners

    kept = torch.zeros((len(pixels), grid.height_px, grid.width_px), dtype=torch.int64, device=pixels.device)
    shares = torch.zeros((*kept.shape, 3), device=pixels.device)
    scene = (to_kernel(pixels), to_kernel(depth), to_kernel(faces.int()))
    keep_nearest_faces(*scene, NEAREST, to_kernel(kept))
    share_corners(*scene, to_kernel(kept), to_kernel(shares))
    return Fragments(torch.where(kept > 0, LAST_FACE - (kept & LAST_FACE), -1), shares)
