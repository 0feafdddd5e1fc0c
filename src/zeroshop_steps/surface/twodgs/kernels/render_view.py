"""What the kernels of 2D Gaussian Splatting need to know of a camera."""

from dataclasses import dataclass, field

import numpy as np
import torch

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.rendering.tiling import TILE_PX
from zeroshop_steps.surface.rendering.training_views import TrainingView


@dataclass(frozen=True)
class RenderView:
    """A view to be drawn.

    Attributes:
        camera: (16,) float64: rotation (9) and translation (3) of camera_from_world, then fx, fy, cx, cy in pixels.
        width_px, height_px: image size.
        tile_active: (ceil(height / 16), ceil(width / 16)) bool, the tiles to draw.
        near: depth before which a surfel is not drawn.
        depth_map: (k1, k2), the distortion term's mapped depth is k1 - k2 / z.
    """

    camera: np.ndarray
    width_px: int
    height_px: int
    tile_active: np.ndarray
    near: float
    depth_map: tuple[float, float]
    _tensors: dict[torch.device, tuple[torch.Tensor, torch.Tensor]] = field(default_factory=dict, compare=False, repr=False)

    @staticmethod
    def from_camera(camera: Camera, near: float, far: float, tile_active: np.ndarray | None = None) -> "RenderView":
        """A view of a pinhole camera; all tiles are active when `tile_active` is None.

        near, far: nearest drawn depth, and the depth of the scene's far end. The distortion term sees z mapped to
            far (z - near) / (z (far - near)) as in the paper, less that of the middle, which changes no difference of
            depths and keeps its sums of squares precise in single precision.
        """
        if tile_active is None:
            tile_active = np.ones((-(-camera.height_px // TILE_PX), -(-camera.width_px // TILE_PX)), bool)
        stretch = near * far / (far - near)
        middle = 2.0 * near * far / (near + far)
        return RenderView(camera.row, camera.width_px, camera.height_px, tile_active, near, (stretch / middle, stretch))

    @staticmethod
    def from_training_view(view: TrainingView) -> "RenderView":
        """A training view, near and far two units from the origin: the normalized object lies within one."""
        distance = float(np.linalg.norm(view.camera.camera_from_world[:3, 3]))
        return RenderView.from_camera(view.camera, max(distance - 2.0, 0.05), distance + 2.0, view.tile_active)

    def on(self, device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
        """Camera and active tiles as tensors of a device, where they are kept."""
        if device not in self._tensors:
            self._tensors[device] = (torch.from_numpy(self.camera).to(device), torch.from_numpy(self.tile_active).to(device))
        return self._tensors[device]
