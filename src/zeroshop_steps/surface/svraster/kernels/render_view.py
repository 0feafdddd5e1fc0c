"""What the kernels of sparse voxels need to know of a camera."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.rendering.tiling import TILE_PX
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.svraster.kernels.tiles import TileOctants


class DeviceView(NamedTuple):
    """Camera and pairs of a view as tensors of one device, as `RenderView` and `TileOctants` have them."""

    camera: torch.Tensor
    tiles: torch.Tensor
    octants: torch.Tensor
    pair_index: torch.Tensor
    of_pixel: torch.Tensor


@dataclass(frozen=True)
class RenderView:
    """A view to be drawn.

    Attributes:
        camera: (16,) float64: rotation (9) and translation (3) of camera_from_world, then fx, fy, cx, cy in pixels.
        width_px, height_px: image size.
        tile_octants: the tiles to draw, one for each octant of their rays.
        near: depth before which nothing is drawn.
    """

    camera: np.ndarray
    width_px: int
    height_px: int
    tile_octants: TileOctants
    near: float
    _tensors: dict[torch.device, DeviceView] = field(default_factory=dict, compare=False, repr=False)

    @staticmethod
    def from_camera(camera: Camera, tile_active: np.ndarray | None = None, near: float = 0.05) -> "RenderView":
        """A view of a pinhole camera; all tiles are drawn when `tile_active` (tiles_y, tiles_x) is None."""
        if tile_active is None:
            tile_active = np.ones((-(-camera.height_px // TILE_PX), -(-camera.width_px // TILE_PX)), bool)
        tile_octants = TileOctants.from_camera(camera.row, tile_active)
        return RenderView(camera.row, camera.width_px, camera.height_px, tile_octants, near)

    @staticmethod
    def from_training_view(view: TrainingView) -> "RenderView":
        """A training view."""
        return RenderView.from_camera(view.camera, view.tile_active)

    @property
    def tile_shape(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return self.tile_octants.index.shape[:2]

    def on(self, device: torch.device) -> DeviceView:
        """Camera and pairs as tensors of a device, where they are kept."""
        if device not in self._tensors:
            pairs = self.tile_octants
            arrays = (self.camera, pairs.tiles, pairs.octants, pairs.index, pairs.of_pixel)
            self._tensors[device] = DeviceView(*(torch.from_numpy(array).to(device) for array in arrays))
        return self._tensors[device]
