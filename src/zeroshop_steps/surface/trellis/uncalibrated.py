"""Without cameras: a mesh of one or two masked photos alone, upright as it was generated, and as high as the user says.

Nothing tells from where the photos were taken. So the mesh is seen from all around, as large and in the place as in the photo, and the
view that is most alike counts. The generated mesh whose views are most like all photos is kept.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import DISTANCE_RADII, direction_at, look_at
from zeroshop_steps.geometry.imaging.images import list_images, read_image, read_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.networks.trellis.conditioning import MARGIN, frame_object
from zeroshop_steps.networks.trellis.flexible_surface import ColoredSurface
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.trellis.photo_fit import ComparedPhoto, PhotoComparison, shrink_photo

AZIMUTHS, ELEVATIONS_DEG = 36, (5.0, 25.0, 45.0, 65.0)
COMPARED_PX = 96
"""Side of the squares that are compared."""


def read_pictures(capture: Path) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Names, images and masks of the first photo and of the one halfway through the capture, which is opposite after one round.

    Raises:
        StepError: there are no photos or no masks, or one is empty.
    """
    images = list_images(capture / "images")
    if not (capture / "masks").is_dir():
        raise StepError(
            f"{capture / 'masks'} does not exist, and without cameras no masks are found; give them (column masks of objects.tsv), or take"
            " a registration in place of none"
        )
    found = []
    for path in [images[index] for index in sorted({0, len(images) // 2})]:
        image, place = read_image(path), capture / "masks" / f"{path.stem}.png"
        mask = read_mask(place, (image.shape[1], image.shape[0]))
        if not mask.any():
            raise StepError(f"mask {place} is empty; it must be 255 on the object and 0 elsewhere")
        found.append((path.name, image, mask))
    return found


def rate_likeness(mesh: Mesh, pictures: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """How little a coloured mesh, z up, resembles pictures, each an image and its mask: 0 where it looks the same, up to 1."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    middle, away = (low + high) / 2, DISTANCE_RADII * float(np.linalg.norm(high - low)) / 2
    renderer, comparison = MeshRenderer(mesh), PhotoComparison(mesh, [])
    squares = [_frame(image, mask) for image, mask in pictures]
    errors = np.full((len(squares), AZIMUTHS * len(ELEVATIONS_DEG)), 1.0)
    for view in range(errors.shape[1]):
        azimuth, elevation = divmod(view, len(ELEVATIONS_DEG))
        outwards = direction_at(2 * np.pi * azimuth / AZIMUTHS, np.radians(ELEVATIONS_DEG[elevation]))
        camera = _aim(renderer, look_at(middle + away * outwards, middle))
        for index, square in enumerate(squares):
            errors[index, view] = comparison.measure(np.eye(4), [replace(square, camera=camera)]).error
    return float(errors.min(1).mean())


def as_generated(surface: ColoredSurface) -> Mesh:
    """The mesh with its colours, in the generator's cube."""
    return Mesh(surface.vertices, surface.faces, colors=np.rint(255 * surface.colors).astype(np.uint8))


def scale_by_height(mesh: Mesh, height_m: float | None) -> Mesh:
    """The mesh about the middle of its box, in mm and as high as given; of the generator's size where no height is known."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    scale = 1.0 if height_m is None else MM_PER_M * height_m / float(high[2] - low[2])
    return replace(mesh, vertices=scale * (mesh.vertices - (low + high) / 2))


def choose_likeliest(meshes: Iterable[Mesh | None], pictures: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[int, Mesh, list[float]]:
    """The index of the mesh that is most like the pictures, that mesh, and the error of each; None counts as an error of 1.

    Raises:
        StepError: all are None.
    """
    best, errors = None, []
    for index, mesh in enumerate(meshes):
        errors.append(1.0 if mesh is None else round(rate_likeness(mesh, pictures), 5))
        if mesh is not None and (best is None or errors[index] < errors[best[0]]):
            best = index, mesh
    if best is None:
        raise StepError(
            f"Trellis made no surface of these photos with any of {len(errors)} seeds; choose another --seed, or check the masks"
        )
    return *best, errors


def _frame(image: np.ndarray, mask: np.ndarray) -> ComparedPhoto:
    """A picture cut out and centred; its camera is not known yet."""
    white = np.full_like(image, 255)
    inside = frame_object(white, mask, COMPARED_PX)[..., 0] >= 128
    unknown = Camera("", COMPARED_PX, COMPARED_PX, np.eye(3), np.eye(4))
    return shrink_photo(unknown, frame_object(image, mask, COMPARED_PX), inside)


def _aim(renderer: MeshRenderer, pose: np.ndarray) -> Camera:
    """The camera of a square picture at this pose in whose middle the mesh is, as large as `frame_object` shows things."""
    focal = COMPARED_PX * DISTANCE_RADII / 3
    wide = Camera("", COMPARED_PX, COMPARED_PX, _intrinsics(focal, np.full(2, COMPARED_PX / 2)), pose)
    left, top, width, height = cv2.boundingRect(renderer.cast_rays(wide).mask.astype(np.uint8))
    grown = COMPARED_PX / MARGIN / max(width, height, 1)
    off = np.array([left + width / 2, top + height / 2]) - COMPARED_PX / 2
    return replace(wide, intrinsics=_intrinsics(grown * focal, COMPARED_PX / 2 - grown * off))


def _intrinsics(focal_px: float, middle_px: np.ndarray) -> np.ndarray:
    return np.array([[focal_px, 0.0, middle_px[0]], [0.0, focal_px, middle_px[1]], [0.0, 0.0, 1.0]])
