"""How well a coloured mesh explains photos: by its outlines and its colours, in all of them together."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_erosion, distance_transform_edt

from zeroshop_steps.geometry.alignment.similarity_icp import similarity_rows
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.transforms import compute_scale, shrink_camera, transform_camera, transform_points
from zeroshop_steps.geometry.imaging.images import EXPOSURE_RANGE
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer, RayHits

COMPARED_PX = 240
"""Longer side of the images that are compared."""
COLOR_RANGE = 0.5
"""Colours that differ by this (root mean square of the channels, of 1) count as much as a missing pixel."""
FARTHEST_SHARE = 0.1
"""Outlines farther than this from those of the mask, as a share of the image, pull no harder."""


@dataclass(frozen=True)
class ComparedPhoto:
    """A photo in the size in which it is compared.

    Attributes:
        camera: of the small image.
        mask: (H, W) bool.
        color: (H, W, 3) float32 from 0 to 1.
        inwards_px: (H, W) distance to the mask's edge, positive inside.
    """

    camera: Camera
    mask: np.ndarray
    color: np.ndarray
    inwards_px: np.ndarray


@dataclass(frozen=True)
class PhotoFit:
    """How a mesh fits all photos.

    Attributes:
        photos_from_mesh: (4, 4) similarity.
        error: 0 where outlines and colours agree, 1 where they have nothing in common.
        overlap: intersection over union of outlines and masks.
    """

    photos_from_mesh: np.ndarray
    error: float
    overlap: float


def shrink_photo(camera: Camera, image: np.ndarray, mask: np.ndarray) -> ComparedPhoto:
    """A photo as it is compared."""
    small = shrink_camera(camera, COMPARED_PX)
    size = small.width_px, small.height_px
    coverage = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    color = cv2.resize((image * mask[..., None]).astype(np.float32) / 255.0, size, interpolation=cv2.INTER_AREA)
    covered = np.pad(coverage >= 0.5, 1)
    inwards = (distance_transform_edt(covered) - distance_transform_edt(~covered))[1:-1, 1:-1]
    return ComparedPhoto(small, coverage >= 0.5, color / np.maximum(coverage, 1e-3)[..., None], inwards.astype(np.float32))


class PhotoComparison:
    """One coloured mesh and the photos that it is compared with."""

    def __init__(self, mesh: Mesh, photos: Sequence[ComparedPhoto]) -> None:
        assert mesh.colors is not None
        self.photos, self._colors, self._faces = photos, mesh.colors.astype(np.float32) / 255.0, mesh.faces
        self._renderer = MeshRenderer(mesh)

    def measure(self, photos_from_mesh: np.ndarray, photos: Sequence[ComparedPhoto] | None = None) -> PhotoFit:
        """How the mesh fits under a (4, 4) similarity, by default in all photos."""
        ours, theirs, joined, together = [], [], 0, 0
        for photo, hits in self._cast(photos_from_mesh, self.photos if photos is None else photos):
            both = hits.mask & photo.mask
            ours.append(self._color(hits, both))
            theirs.append(photo.color[both])
            joined += int((hits.mask | photo.mask).sum())
            together += int(both.sum())
        mine, photographed = np.concatenate(ours), np.concatenate(theirs)
        gains = np.clip((mine * photographed).sum(0) / np.maximum((mine**2).sum(0), 1e-9), *EXPOSURE_RANGE)
        apart = np.sqrt(((mine * gains - photographed) ** 2).mean(1)) / COLOR_RANGE if together else np.zeros(0)
        error = (joined - together + float(np.minimum(apart, 1.0).sum())) / max(joined, 1)
        return PhotoFit(photos_from_mesh, float(error), together / max(joined, 1))

    def outline_rows(self, photos_from_mesh: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A Gauss-Newton step's (1, N, 7) rows, (1, N) gaps and (1, N) weights that bring the outlines onto the masks' edges.

        There are none where no photo shows the mesh.

        Args:
            photos_from_mesh: (4, 4) the similarity so far.
            middle: (3,) about which it changes.
        """
        rows, gaps, weights = [np.zeros((0, 7))], [np.zeros(0)], [np.zeros(0)]
        for photo, hits in self._cast(photos_from_mesh, self.photos):
            contour = hits.mask & ~binary_erosion(hits.mask, border_value=1)
            row, column = np.nonzero(contour)
            if len(row) == 0:
                continue
            depth = hits.depth[row, column] * compute_scale(photos_from_mesh)
            k = photo.camera.intrinsics
            seen = np.stack([(column + 0.5 - k[0, 2]) / k[0, 0] * depth, (row + 0.5 - k[1, 2]) / k[1, 1] * depth, depth], 1)
            down, right = (slope[row, column] for slope in np.gradient(photo.inwards_px))
            across = right * k[0, 0] / depth
            along = down * k[1, 1] / depth
            direction = np.stack([across, along, -(across * seen[:, 0] + along * seen[:, 1]) / depth], 1)
            pose = photo.camera.camera_from_world
            points = (seen - pose[:3, 3]) @ pose[:3, :3]
            limit = FARTHEST_SHARE * max(photo.mask.shape)
            # On the mask's own contour the distance to its edge is half a pixel.
            inwards = photo.inwards_px[row, column] - np.where(photo.mask[row, column], 1.0, 0.0)
            rows.append(similarity_rows(points - middle, direction @ pose[:3, :3]))
            gaps.append(-np.clip(inwards, -limit, limit))
            weights.append(1.0 / (1.0 + np.abs(gaps[-1])))
        return np.concatenate(rows)[None], np.concatenate(gaps)[None], np.concatenate(weights)[None]

    def _cast(self, photos_from_mesh: np.ndarray, photos: Sequence[ComparedPhoto]) -> list[tuple[ComparedPhoto, RayHits]]:
        """The photos, and what their rays hit of the moved mesh: the mesh stays, and the cameras move instead."""
        back = np.linalg.inv(photos_from_mesh)
        return [(photo, self._renderer.cast_rays(transform_camera(photo.camera, back))) for photo in photos]

    def _color(self, hits: RayHits, where: np.ndarray) -> np.ndarray:
        """(N, 3) colours of the mesh at the pixels `where`."""
        corners = self._colors[self._faces[hits.face[where]]]
        second, third = hits.barycentric[where].T[:, :, None]
        return corners[:, 0] * (1.0 - second - third) + corners[:, 1] * second + corners[:, 2] * third


def middle_of(mesh: Mesh, photos_from_mesh: np.ndarray) -> np.ndarray:
    """(3,) the middle of the moved mesh's box."""
    moved = transform_points(mesh.vertices, photos_from_mesh)
    return (moved.min(0) + moved.max(0)) / 2
