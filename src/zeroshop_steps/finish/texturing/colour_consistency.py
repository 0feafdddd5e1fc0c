"""Whether photos agree on a surface by colour: each pixel is compared with what the other photos show at the place that it sees.

A wrong surface mixes places, and their colours differ even where the surface is plain, because of its shading (Kutulakos and Seitz, A
Theory of Shape by Space Carving, IJCV 2000). The same pixels are asked for every candidate surface, so that their answers compare.

Highlights move with the camera and differ on the right surface, too. They have the colour of the light, about white, and add to the
colour of the surface. So on a coloured surface what is left of linear light without its grey part is compared, which a highlight does
not change (Mallick et al., Beyond Lambert: Reconstructing Specular Surfaces Using Color, CVPR 2005). On a grey one all is compared.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.finish.texturing.exposure_gains import estimate_gains
from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.alignment.surface_distance import sample_surface
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.transforms import shrink_camera
from zeroshop_steps.geometry.imaging.images import BLUR_PX, sample_bilinear
from zeroshop_steps.geometry.imaging.srgb import srgb_to_linear
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.visibility import GRAZING_COSINE, VISIBLE_SHARE
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

LONGEST_PX, MARGIN_PX = 480, 8
"""Photos are cut out around the mask, with this margin, and made smaller to this longest side."""
EDGE_PX = 2
"""Pixels this near to the border of a mask mix the object with what is behind it."""
BRIGHTEST = 250.0
"""Brighter pixels are saturated, and tell no colour."""
COLOURED, COLOURED_SHARE = 2.0, 0.15
"""A surface is coloured if, in the middle of its pixels, linear light without its grey part is at least this, of 255, and this share of
the grey part."""
GAIN_POINTS = 1500
"""Of the surface, by which the exposures of the photos are compared."""


@dataclass(frozen=True)
class Pixels:
    """Pixels of all photos: (N,) the photo of each, and (N, 2) positions, the centre of the first pixel being (0.5, 0.5)."""

    photo: np.ndarray
    position: np.ndarray

    def chosen(self, which: np.ndarray) -> "Pixels":
        """Some of them, by (N,) bool or index."""
        return Pixels(self.photo[which], self.position[which])


@dataclass(frozen=True)
class Sight:
    """What N rays of pixels hit: (N, 3) places, (N, 3) unit normals, and (N,) bool whether they hit anything."""

    place: np.ndarray
    normal: np.ndarray
    hit: np.ndarray


class Photos:
    """Photos with their masks, blurred, and made equally bright by a mesh that they show.

    Attributes:
        coloured: whether colours are compared without their grey part.
        gains: (V,) factors that make the photos equally bright.
    """

    def __init__(self, views: Sequence[View], mesh: Mesh) -> None:
        kernel = np.ones((2 * EDGE_PX + 1,) * 2, np.uint8)
        self.cameras: list[Camera] = []
        self.images: list[np.ndarray] = []
        self.inside: list[np.ndarray] = []
        for view in views:
            mask = view.mask().astype(np.uint8)
            camera, window = _crop(view.camera, mask)
            size = (camera.width_px, camera.height_px)
            image = cv2.resize(view.image()[window], size, interpolation=cv2.INTER_AREA).astype(np.float32)
            small = cv2.resize(mask[window] * 255, size, interpolation=cv2.INTER_AREA)
            self.cameras.append(camera)
            self.images.append(cv2.GaussianBlur(image, (0, 0), BLUR_PX))
            self.inside.append(cv2.erode((small == 255).astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0)
        self.diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        self.gains = np.ones(len(views), np.float32)
        self.coloured = False

    def adapt(self, pixels: Pixels, mesh: Mesh) -> None:
        """See whether the surface that these pixels show is coloured, and compare the exposures of the photos by a mesh."""
        light = np.concatenate(
            [_linear(self._sample(photo, pixels.chosen(pixels.photo == photo).position)[0]) for photo in set(pixels.photo)]
        )
        grey = light.mean(1)
        colour = np.median(np.sqrt(((light - grey[:, None]) ** 2).mean(1)))
        self.coloured = bool(colour > COLOURED and colour > COLOURED_SHARE * np.median(grey))
        points, faces, _ = sample_surface(mesh, GAIN_POINTS, np.random.default_rng(0))
        seen, known = self._observe(ray_caster((mesh.vertices, mesh.faces)), points, mesh.face_normals()[faces])
        brightness = np.ptp(_linear(seen), axis=2) if self.coloured else seen.mean(2)
        self.gains = estimate_gains(brightness / 255.0, known.astype(np.float32), known)

    def pixels(self, step_share: float) -> Pixels:
        """Pixels inside the masks on a grid, whose step is a share of the square root of the mask's area."""
        photo, position = [], []
        for number, inside in enumerate(self.inside):
            step = max(1, round(step_share * float(np.sqrt(inside.sum()))))
            rows, columns = np.nonzero(inside[::step, ::step])
            photo.append(np.full(len(rows), number))
            position.append(np.stack([columns, rows], 1) * step + 0.5)
        return Pixels(np.concatenate(photo), np.concatenate(position))

    def deviations(self, scene: o3d.t.geometry.RaycastingScene, pixels: Pixels) -> np.ndarray:
        """(N,) how far the colour of each pixel is from the mean of the others, of 255; NaN where too few show its place.

        The deviation is the root mean square of the three channels.

        Args:
            scene: of the surface that the pixels see.
            pixels: of the photos.
        """
        sight = see(scene, self.cameras, pixels)
        own, known = np.zeros((len(pixels.photo), 3), np.float32), np.zeros(len(pixels.photo), bool)
        for photo in np.unique(pixels.photo):
            at = np.flatnonzero(pixels.photo == photo)
            own[at], known[at] = self._sample(photo, pixels.position[at])
        at = np.flatnonzero(known & sight.hit)
        colours, shown = self._observe(scene, sight.place[at], sight.normal[at])
        shown[np.arange(len(at)), pixels.photo[at]] = False
        count = shown.sum(1)
        compared = self._compared(colours, self.gains[:, None])
        mean = (compared * shown[..., None]).sum(1) / np.maximum(count, 1)[:, None]
        difference = self._compared(own[at], self.gains[pixels.photo[at], None]) - mean
        found = np.full(len(pixels.photo), np.nan)
        found[at] = np.where(count >= AGREEING_VIEWS, np.sqrt((difference**2).mean(1)), np.nan)
        return found

    def _compared(self, colours: np.ndarray, gains: np.ndarray) -> np.ndarray:
        """What is compared of (..., 3) colours of photos with such gains: without highlights where the surface is coloured."""
        if not self.coloured:
            return colours * gains
        light = _linear(colours) * gains
        return light - light.mean(-1, keepdims=True)

    def _observe(self, scene: o3d.t.geometry.RaycastingScene, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, V, 3) float32 colours of points of a surface in all photos, and (N, V) bool where they are shown."""
        colours = np.zeros((len(points), len(self.cameras), 3), np.float32)
        shown = np.zeros(colours.shape[:2], bool)
        start = points + VISIBLE_SHARE * self.diagonal * normals
        for photo, camera in enumerate(self.cameras):
            towards = camera.centre_in_world - points
            facing = np.einsum("nc,nc->n", towards, normals) > GRAZING_COSINE * np.linalg.norm(towards, axis=1)
            at = np.flatnonzero(facing & camera.find_pixels(points)[3])
            rays = np.concatenate([start[at], camera.centre_in_world - start[at]], 1)
            at = at[~np.isfinite(scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy())]
            if len(at):
                colours[at, photo], shown[at, photo] = self._sample(photo, camera.project(points[at])[0])
        return colours, shown

    def _sample(self, photo: int, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) colours at (N, 2) positions in an image, and (N,) bool whether they are the object's and not saturated."""
        column, row = np.floor(position).astype(int).T
        colour = sample_bilinear(self.images[photo], (position - 0.5).astype(np.float32), cv2.BORDER_REPLICATE)
        return colour, self.inside[photo][row, column] & (colour.max(1) < BRIGHTEST)


def _linear(colours: np.ndarray) -> np.ndarray:
    """Linear light of sRGB colours, both of 255."""
    return np.asarray(255.0 * srgb_to_linear(colours / np.float32(255.0)), np.float32)


def see(scene: o3d.t.geometry.RaycastingScene, cameras: Sequence[Camera], pixels: Pixels) -> Sight:
    """What pixels of cameras see of a surface."""
    rays = np.zeros((len(pixels.photo), 6))
    for photo in np.unique(pixels.photo):
        camera, at = cameras[photo], np.flatnonzero(pixels.photo == photo)
        ahead = np.concatenate([pixels.position[at], np.ones((len(at), 1))], 1) @ np.linalg.inv(camera.intrinsics).T
        rays[at, :3], rays[at, 3:] = camera.centre_in_world, ahead @ camera.camera_from_world[:3, :3]
    answer = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))
    distance = answer["t_hit"].numpy()
    hit = np.isfinite(distance)
    place = rays[:, :3] + np.where(hit, distance, 0.0)[:, None] * rays[:, 3:]
    normal = np.where(hit[:, None], answer["primitive_normals"].numpy(), 0.0)
    return Sight(place, normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12), hit)


def _crop(camera: Camera, mask: np.ndarray) -> tuple[Camera, tuple[slice, slice]]:
    """The camera of the part of an image around its mask, no larger than LONGEST_PX, and the rows and columns of that part."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        rows, columns = np.array([0]), np.array([0])
    top, left = max(int(rows[0]) - MARGIN_PX, 0), max(int(columns[0]) - MARGIN_PX, 0)
    bottom, right = min(int(rows[-1]) + MARGIN_PX + 1, camera.height_px), min(int(columns[-1]) + MARGIN_PX + 1, camera.width_px)
    part = camera.cropped(left, top, right - left, bottom - top)
    return shrink_camera(part, LONGEST_PX), (slice(top, bottom), slice(left, right))
