"""What the networks see of a pose: the same square cut out of the photo and of a rendering of the model, colours and points.

Half pixels are kept as the published weights know them. A rendering of 160 pixels spans 159 of the 160 parts of the window and takes
K's origin for a corner of the image; depth takes it for the middle of the first pixel. The photo is sampled as by Kornia 0.7.2's
`warp_perspective`, which goes from pixels to shares of the image by other rules than back (`_find_source`).
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from zeroshop_steps.geometry.cameras.pinhole import NEAREST_MM
from zeroshop_steps.geometry.meshes.surface_parts import with_texture
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.rasterization import Fragments, PixelGrid, rasterize
from zeroshop_steps.networks.foundationpose.settings import CROP_PX, REFINER_MARGIN, SCORER_MARGIN

AMBIENT, DIFFUSE = 0.8, 0.5  # of the light from the camera, as shares of the colour
PLAIN = 128 / 255  # colour of a model without texture
MOST_RADII = 2.0  # coordinates farther from the pose's centre become 0, each on its own


@dataclass(frozen=True)
class CropStyle:
    """What differs between the crops of the two networks.

    Attributes:
        margin: sides of the windows at the depth of the object, in its diameters.
        nearest_mm: depth below which nothing counts as seen.
        there_and_back: whether depth is cut out, put back into the image and cut out again, each time by the nearest pixel.
    """

    margin: float
    nearest_mm: float
    there_and_back: bool


FOR_REFINER = CropStyle(REFINER_MARGIN, NEAREST_MM, there_and_back=False)
FOR_SCORER = CropStyle(SCORER_MARGIN, 100.0, there_and_back=True)


@dataclass(frozen=True)
class Observation:
    """A photo with depth, on the device.

    Attributes:
        colors: (1, 3, H, W) 0 to 1.
        depth_mm: (H, W) 0 where nothing was measured.
        intrinsics: (3, 3) BOP's K.
    """

    colors: Tensor
    depth_mm: Tensor
    intrinsics: Tensor

    @staticmethod
    def of(photo: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, device: torch.device) -> "Observation":
        """From a (H, W, 3) uint8 photo and its (H, W) depth."""
        colors = torch.from_numpy(photo.copy()).to(device).permute(2, 0, 1)[None].float() / 255
        return Observation(colors, *(torch.as_tensor(values, dtype=torch.float32, device=device) for values in (depth_mm, intrinsics)))


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

        mesh = with_texture(mesh) if mesh.is_colored else mesh
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


def cut_pairs(seen: Observation, model: DrawnModel, camera_from_model: Tensor, style: CropStyle) -> CropPairs:
    """Cut out what a network sees of (N, 4, 4) poses in mm of a model in a photo, in single precision whatever the networks run in."""
    with torch.autocast(camera_from_model.device.type, enabled=False):
        return _cut_pairs(seen, model, camera_from_model, style)


def _cut_pairs(seen: Observation, model: DrawnModel, camera_from_model: Tensor, style: CropStyle) -> CropPairs:
    corner, side_px = place_windows(camera_from_model, seen.intrinsics, style.margin * model.diameter_mm)
    centres = camera_from_model[:, :3, 3, None, None]

    def normalize(points: Tensor) -> Tensor:
        relative = (points - centres) / (model.diameter_mm / 2)
        return torch.where((points[:, 2:] < style.nearest_mm) | (relative.abs() >= MOST_RADII), 0.0, relative)

    drawn_colors, drawn_points = render_windows(model, camera_from_model, seen.intrinsics, corner, side_px)
    colors, points = sample_colors(seen, corner, side_px), sample_points(seen, corner, side_px, style.there_and_back)
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


def sample_colors(seen: Observation, corner: Tensor, side_px: Tensor) -> Tensor:
    """(N, 3, CROP_PX, CROP_PX) colours of the photo in these windows, bilinear, 0 outside."""
    size_px = _size_of(seen)
    places = _find_source(_spread(corner, side_px), size_px)
    relative = (2 * places + 1) / size_px - 1  # of the whole image, -1 to 1
    shape = (len(corner), CROP_PX, CROP_PX)
    grid = torch.stack([relative[:, None, :, 0].expand(shape), relative[:, :, None, 1].expand(shape)], dim=3)
    return F.grid_sample(seen.colors, grid.flatten(0, 1)[None], align_corners=False)[0].unflatten(1, shape[:2]).transpose(0, 1)


def sample_points(seen: Observation, corner: Tensor, side_px: Tensor, there_and_back: bool) -> Tensor:
    """(N, 3, CROP_PX, CROP_PX) mm, camera frame: the points of the nearest pixels in these windows, 0 where nothing was measured."""
    size_px = _size_of(seen)
    pixels = _find_source(_spread(corner, side_px), size_px).round()  # (N, CROP_PX, 2) column and row
    source, inside = pixels, (pixels >= 0) & (pixels < size_px)
    if there_and_back:
        back = _find_source((pixels - corner[:, None]) * CROP_PX / side_px[:, None], torch.full_like(size_px, CROP_PX)).round()
        source = _find_source(corner[:, None] + back * side_px[:, None] / CROP_PX, size_px).round()
        inside = inside & (back >= 0) & (back < CROP_PX) & (source >= 0) & (source < size_px)
    column, row = source.minimum(size_px - 1).clamp(min=0).long().unbind(2)
    depth = seen.depth_mm[row[:, :, None], column[:, None]] * (inside[:, :, None, 1] & inside[:, None, :, 0])
    slopes = (pixels - seen.intrinsics[:2, 2]) / torch.stack([seen.intrinsics[0, 0], seen.intrinsics[1, 1]])
    return torch.stack([slopes[:, None, :, 0] * depth, slopes[:, :, None, 1] * depth, depth], dim=1)


def _size_of(seen: Observation) -> Tensor:
    """(2,) width and height of the photo in pixels."""
    height, width = seen.depth_mm.shape
    return torch.tensor([float(width), float(height)], device=seen.depth_mm.device)


def _spread(corner: Tensor, side_px: Tensor) -> Tensor:
    """(N, CROP_PX, 2) where the columns and rows of crops lie in the photo."""
    return corner[:, None] + torch.arange(CROP_PX, device=corner.device)[:, None] * side_px[:, None] / CROP_PX


def _find_source(place: Tensor, size_px: Tensor) -> Tensor:
    """The pixel of an image of this size that is read for a place in it: Kornia 0.7.2 takes the middles of the outer pixels for the
    ends of the image, and PyTorch, which reads it, their edges."""
    return place * size_px / (size_px - 1) - 0.5
