"""Draw a preview: input photos, and below them the textured mesh and its bare shape from the same cameras; without cameras, from around."""

from collections.abc import Sequence

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View, space_evenly
from zeroshop_steps.geometry.cameras.transforms import crop_to_mask
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, place_around
from zeroshop_steps.geometry.imaging.contact_sheets import COLUMNS, TILE_WIDTH_PX
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer

AROUND_ELEVATION_DEG = 25.0  # from where a mesh without cameras is seen


def draw_around(mesh: Mesh, count: int = COLUMNS) -> np.ndarray:
    """Two rows of tiles (textured mesh, bare shape) from `count` sides, z up."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    renderer = MeshRenderer(mesh)
    columns = []
    for azimuth_rad in 2 * np.pi * np.arange(count) / count:
        tile = place_around(middle, radius, direction_at(azimuth_rad, np.radians(AROUND_ELEVATION_DEG)), TILE_WIDTH_PX)
        rows = [renderer.render_color(tile), renderer.render_shaded(tile)]
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
        tile = camera.resized(TILE_WIDTH_PX, TILE_WIDTH_PX)
        interpolation = cv2.INTER_AREA if camera.width_px > TILE_WIDTH_PX else cv2.INTER_CUBIC
        rows: list[np.ndarray] = [cv2.resize(photo, (TILE_WIDTH_PX, TILE_WIDTH_PX), interpolation=interpolation)]
        rows += [renderer.render_color(tile), renderer.render_shaded(tile)]
        columns.append(np.concatenate(rows, 0))
    return np.concatenate(columns, 1)
