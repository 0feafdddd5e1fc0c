"""What the networks see of a pose: the same square cut out of the photo and of a rendering of the model, colours and points.

Half pixels are kept as the published weights were trained with: a rendering of 160 pixels spans 159 of the 160 parts of the window
and takes K's origin for a corner of the image; depth takes it for the middle of the first pixel; the photo is sampled with Kornia's
`warp_perspective` and its `align_corners=False`.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.geometry.rasterization import Fragments, PixelGrid, rasterize
from zeroshop_steps.networks.foundationpose.settings import CROP_PX

AMBIENT, DIFFUSE = 0.8, 0.5  # of the light from the camera, as shares of the colour
PLAIN = 128 / 255  # colour of a model without texture
MOST_RADII = 2.0  # coordinates farther from the pose's centre become 0, each on its own
NEAREST_MM = 1.0  # depth below which nothing counts as seen, or a pose as in front of the camera


@dataclass(frozen=True)
class Observation:
    """A photo with depth, on the device.

    Attributes:
        colors: (1, 3, H, W) 0 to 1.
        points: (1, 3, H, W) mm, camera frame, 0 where nothing was measured.
        intrinsics: (3, 3) BOP's K.
    """

    colors: Tensor
    points: Tensor
    intrinsics: Tensor

    @staticmethod
    def of(photo: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, device: torch.device) -> "Observation":
        """From a (H, W, 3) uint8 photo and its (H, W) depth."""
        height, width = depth_mm.shape
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        slopes = [(columns - intrinsics[0, 2]) / intrinsics[0, 0], (rows - intrinsics[1, 2]) / intrinsics[1, 1], np.ones((height, width))]
        points = np.stack(slopes) * np.where(depth_mm > NEAREST_MM, depth_mm, 0.0)
        colors = torch.from_numpy(photo.copy()).to(device).permute(2, 0, 1)[None].float() / 255
        tensor = torch.as_tensor(points, dtype=torch.float32, device=device)[None]
        return Observation(colors, tensor, torch.as_tensor(intrinsics, dtype=torch.float32, device=device))


@dataclass(frozen=True)
class DrawnModel:
    """A model that can be rendered, on the device; its origin is the centre of its box.

    Attributes:
        vertices, normals: (V, 3) mm, and unit vectors.
        faces: (F, 3) int64.
        uv: (V, 2) origin at the texture's lower left, and `texture`: (1, 3, h, w) 0 to 1; None where the model has none.
        diameter_mm: largest distance between two vertices.
    """

    vertices: Tensor
    normals: Tensor
    faces: Tensor
    uv: Tensor | None
    texture: Tensor | None
    diameter_mm: float

    @staticmethod
    def of(mesh: Mesh, centre: np.ndarray, diameter_mm: float, device: torch.device) -> "DrawnModel":
        """A mesh in mm, moved so that `centre` is its origin."""

        def tensor(values: np.ndarray) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=device)

        textured = mesh.is_textured
        uv = tensor(mesh.texture_coordinates) if textured else None
        texture = tensor(mesh.texture_image).permute(2, 0, 1)[None] / 255 if textured else None
        faces = torch.as_tensor(mesh.faces, dtype=torch.int64, device=device)
        return DrawnModel(tensor(mesh.vertices - centre), tensor(mesh.vertex_normals), faces, uv, texture, diameter_mm)


@dataclass(frozen=True)
class CropPairs:
    """N poses of a model as the networks see them.

    Attributes:
        rendered, observed: (N, 6, CROP_PX, CROP_PX) colours and points (networks/foundationpose/model.py).
        camera_from_model: (N, 4, 4) mm, of the model whose origin is its centre.
    """

    rendered: Tensor
    observed: Tensor
    camera_from_model: Tensor


def cut_pairs(seen: Observation, model: DrawnModel, camera_from_model: Tensor, margin: float, nearest_mm: float = NEAREST_MM) -> CropPairs:
    """Cut out what the networks see.

    Args:
        seen: the photo.
        model: what is rendered.
        camera_from_model: (N, 4, 4) mm.
        margin: sides of the windows at the depth of the object, in its diameters.
        nearest_mm: depth below which nothing counts as seen.
    """
    corner, side_px = place_windows(camera_from_model, seen.intrinsics, margin * model.diameter_mm)
    centres = camera_from_model[:, :3, 3, None, None]

    def normalize(points: Tensor) -> Tensor:
        relative = (points - centres) / (model.diameter_mm / 2)
        return torch.where((points[:, 2:] < nearest_mm) | (relative.abs() >= MOST_RADII), 0.0, relative)

    drawn_colors, drawn_points = render_windows(model, camera_from_model, seen.intrinsics, corner, side_px)
    colors, points = sample_windows(seen, corner, side_px)
    return CropPairs(torch.cat([drawn_colors, normalize(drawn_points)], 1), torch.cat([colors, normalize(points)], 1), camera_from_model)


def place_windows(camera_from_model: Tensor, intrinsics: Tensor, width_mm: float) -> tuple[Tensor, Tensor]:
    """(N, 2) upper left corners and (N, 2) widths and heights in whole pixels of windows around objects `width_mm` wide."""
    centres = camera_from_model[:, :3, 3]
    depths = centres[:, 2:].clamp(min=NEAREST_MM)
    focal = torch.stack([intrinsics[0, 0], intrinsics[1, 1]])
    middle = centres[:, :2] / depths * focal + intrinsics[:2, 2]
    half = width_mm / 2 * focal.max() / depths
    corner, end = (middle - half).round(), (middle + half).round()
    return corner, (end - corner).clamp(min=1.0)


def render_windows(
    model: DrawnModel, camera_from_model: Tensor, intrinsics: Tensor, corner: Tensor, side_px: Tensor
) -> tuple[Tensor, Tensor]:
    """(N, 3, CROP_PX, CROP_PX) colours from 0 to 1 and points in mm of the model in these windows, 0 beside it."""
    points = model.vertices @ camera_from_model[:, :3, :3].transpose(1, 2) + camera_from_model[:, None, :3, 3]
    focal = torch.stack([intrinsics[0, 0], intrinsics[1, 1]])
    step_px = side_px * (CROP_PX - 1) / CROP_PX / CROP_PX
    first = (corner + step_px / 2 - intrinsics[:2, 2]) / focal
    fragments = rasterize(points, model.faces, PixelGrid(first, step_px / focal, CROP_PX, CROP_PX))
    drawn = (fragments.face >= 0)[..., None]
    facing = (model.normals @ -camera_from_model[:, 2, :3].T).clamp(0, 1).T[..., None]  # (N, V, 1), towards the camera
    seen = fragments.interpolate(torch.cat([points, facing], dim=2), model.faces)
    colors = (_look_up_colors(model, fragments) * (AMBIENT + DIFFUSE * seen[..., 3:])).clamp(0, 1) * drawn
    return colors.permute(0, 3, 1, 2), seen[..., :3].permute(0, 3, 1, 2)


def _look_up_colors(model: DrawnModel, fragments: Fragments) -> Tensor:
    """(N, H, W, 3) 0 to 1, bilinear in the texture, which repeats."""
    if model.uv is None or model.texture is None:
        return torch.full((*fragments.face.shape, 3), PLAIN, device=fragments.face.device)
    height, width = model.texture.shape[2:]
    uv = fragments.interpolate(model.uv, model.faces)
    around = F.pad(model.texture, (1, 1, 1, 1), mode="circular")
    column, row = (uv[..., 0] % 1.0) * width + 1.0, ((1.0 - uv[..., 1]) % 1.0) * height + 1.0
    grid = torch.stack([2 * column / (width + 2) - 1, 2 * row / (height + 2) - 1], dim=3)
    return F.grid_sample(around, grid.flatten(0, 1)[None], align_corners=False)[0].permute(1, 2, 0).unflatten(0, grid.shape[:2])


def sample_windows(seen: Observation, corner: Tensor, side_px: Tensor) -> tuple[Tensor, Tensor]:
    """(N, 3, CROP_PX, CROP_PX) colours, bilinear, and points, those of the nearest pixel, of the photo; 0 outside."""
    height, width = seen.colors.shape[2:]
    place = corner[:, None] + torch.arange(CROP_PX, device=corner.device)[:, None] * (side_px / CROP_PX)[:, None]  # (N, CROP_PX, 2)
    relative = 2 * place / torch.tensor([width - 1.0, height - 1.0], device=corner.device) - 1
    shape = (len(corner), CROP_PX, CROP_PX)
    grid = torch.stack([relative[:, None, :, 0].expand(shape), relative[:, :, None, 1].expand(shape)], dim=3)

    def sample(image: Tensor, mode: str) -> Tensor:
        return F.grid_sample(image, grid.flatten(0, 1)[None], mode=mode, align_corners=False)[0].unflatten(1, shape[:2]).transpose(0, 1)

    return sample(seen.colors, "bilinear"), sample(seen.points, "nearest")
