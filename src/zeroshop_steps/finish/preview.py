"""Draw a preview: input photos, and below them the textured mesh and its bare shape from the same cameras; without cameras, from around."""

from collections.abc import Sequence

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View, space_evenly
from zeroshop_steps.geometry.cameras.transforms import crop_to_mask
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at, make_intrinsics
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer

TILE_PX = 320
COLUMNS = 6  # photos, or sides
WHITE = (255, 255, 255)
SAMPLES = 3  # rays along each side of a pixel
AROUND_DIAGONALS, AROUND_ELEVATION_DEG = 3.0, 25.0  # from where a mesh without cameras is seen


def draw_around(mesh: Mesh, count: int = COLUMNS) -> np.ndarray:
    """Two rows of tiles (textured mesh, bare shape) from `count` sides, z up."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    middle, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    intrinsics = make_intrinsics(TILE_PX * np.sqrt(AROUND_DIAGONALS**2 - 0.25), TILE_PX, TILE_PX)  # the sphere about the box fills a tile
    renderer = MeshRenderer(mesh)
    columns = []
    for azimuth_rad in 2 * np.pi * np.arange(count) / count:
        centre = middle + AROUND_DIAGONALS * diagonal * direction_at(azimuth_rad, np.radians(AROUND_ELEVATION_DEG))
        tile = Camera("", TILE_PX, TILE_PX, intrinsics, look_at(centre, middle))
        rows = [renderer.render_color(tile, WHITE, SAMPLES), renderer.render_shaded(tile, samples=SAMPLES)]
        columns.append(np.concatenate(rows, 0))
    return np.concatenate(columns, 1)


def draw_preview(mesh: Mesh, views: Sequence[View], count: int = COLUMNS) -> np.ndarray:
    """Three rows of tiles (photo, textured mesh, bare shape) with one column for each of `count` photos, cropped to the object.

    Args:
        mesh: textured.
        views: registered photos with masks, cameras in the frame of the mesh.
        count: how many of them are shown.
    """
    renderer = MeshRenderer(mesh)
    chosen = [views[number] for number in space_evenly(len(views), count)]
    columns = []
    for view in chosen:
        camera, left, top = crop_to_mask(view.camera, view.mask())
        photo = np.full((camera.height_px, camera.width_px, 3), 255, np.uint8)
        image = view.image()
        x0, y0 = max(left, 0), max(top, 0)
        x1, y1 = min(left + camera.width_px, image.shape[1]), min(top + camera.height_px, image.shape[0])
        photo[y0 - top : y1 - top, x0 - left : x1 - left] = image[y0:y1, x0:x1]
        tile = camera.resized(TILE_PX, TILE_PX)
        interpolation = cv2.INTER_AREA if camera.width_px > TILE_PX else cv2.INTER_CUBIC
        rows: list[np.ndarray] = [cv2.resize(photo, (TILE_PX, TILE_PX), interpolation=interpolation)]
        rows += [renderer.render_color(tile, WHITE, SAMPLES), renderer.render_shaded(tile, samples=SAMPLES)]
        columns.append(np.concatenate(rows, 0))
    return np.concatenate(columns, 1)
