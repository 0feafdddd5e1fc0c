"""A plain mug and its photos: the inside has the shading of a hollow, the outside is printed; and the same mug with a lid."""

from collections.abc import Callable
from pathlib import Path

import manifold3d
import numpy as np

from helpers.carton_scene import camera_at
from helpers.memory_view import MemoryView
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.srgb import linear_to_srgb, srgb_to_linear
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer

RADIUS_MM, HEIGHT_MM, WALL_MM, FLOOR_MM = 40.0, 80.0, 5.0, 8.0
"""It stands on z = -HEIGHT_MM / 2."""
UP = np.array([0.0, 0.0, 1.0])
LIGHT = np.array([0.3, -0.2, 0.93])
DARKENING_MM = 30.0
"""A hollow is darker by a factor e this far below its rim."""

RED = np.array([200.0, 70.0, 50.0])
Paint = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""(N, 3) sRGB, or (N,) grey, of (N, 3) places with (N, 3) unit normals, seen along (N, 3) unit directions towards the camera."""


def mug(hollow_mm: float = HEIGHT_MM - FLOOR_MM) -> Mesh:
    """The mug with a handle, hollow down to this depth below the rim; finer than voxels."""
    half = HEIGHT_MM / 2
    body = manifold3d.Manifold.cylinder(HEIGHT_MM, RADIUS_MM, circular_segments=96).translate((0, 0, -half))
    gap = manifold3d.Manifold.cube((14.0, 20.0, 34.0), True).translate((47.0, 0, 0))
    handle = manifold3d.Manifold.cube((24.0, 9.0, 50.0), True).translate((45.0, 0, 0)) - gap
    whole = body + handle
    if hollow_mm > 0:
        inside = manifold3d.Manifold.cylinder(hollow_mm + 5, RADIUS_MM - WALL_MM, circular_segments=96)
        whole -= inside.translate((0, 0, half - hollow_mm))
    fine = whole.refine_to_length(6.0).to_mesh()
    return Mesh(np.array(fine.vert_properties, float)[:, :3], np.array(fine.tri_verts, np.int64)).with_normals()


def shaded(places: np.ndarray, normals: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Print outside; inside plain and darker the deeper, as in a hollow that light enters from above, and brighter on one side."""
    inside = (np.hypot(places[:, 0], places[:, 1]) < RADIUS_MM - 0.5) & (places[:, 2] < HEIGHT_MM / 2 - 0.5)
    printed = 130 + 50 * np.sin(places @ np.array([0.35, 0.3, 0.4]))
    deep = np.exp((places[:, 2] - HEIGHT_MM / 2) / DARKENING_MM)
    return np.where(inside, (60 + 90 * deep) * (0.8 + 0.2 * np.clip(normals @ LIGHT, -1, 1)), printed)


def glossy(places: np.ndarray, normals: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Plain and grey, with a wide highlight that moves with the camera."""
    return 90 + 120 * _highlight(normals, towards)


def glazed(places: np.ndarray, normals: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Red, shaded as a hollow, with highlights of white light on it."""
    grey = shaded(places, normals, towards) / 150.0
    light = srgb_to_linear(np.clip(grey[:, None] * RED / 255.0, 0, 1)) + 0.3 * _highlight(normals, towards)[:, None]
    return 255.0 * linear_to_srgb(np.clip(light, 0, 1))


def _highlight(normals: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(N,) from 0 to 1, of a light above (Blinn 1977)."""
    halfway = LIGHT + towards
    halfway /= np.linalg.norm(halfway, axis=1, keepdims=True)
    return np.clip(np.einsum("nc,nc->n", halfway, normals), 0, 1) ** 25


def matt(places: np.ndarray, normals: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Plain and matt, as bright as it faces the light."""
    return 60 + 90 * np.clip(normals @ LIGHT, 0, 1)


def photograph(mesh: Mesh, paint: Paint, noise: float = 1.0) -> list[View]:
    """Two rings of photos of a mesh."""
    random, renderer = np.random.default_rng(0), MeshRenderer(mesh)
    cameras = [camera_at(f"low{k}.png", 45.0 * k, 2.0, 300.0) for k in range(8)]
    cameras += [camera_at(f"high{k}.png", 36.0 * k + 10.0, 45.0, 300.0) for k in range(10)]
    return [_photograph(renderer, camera, paint, random, noise) for camera in cameras]


def _photograph(renderer: MeshRenderer, camera: Camera, paint: Paint, random: np.random.Generator, noise: float) -> View:
    hits = renderer.cast_rays(camera)
    rows, columns = np.nonzero(hits.mask)
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], 1) @ np.linalg.inv(camera.intrinsics).T
    places = camera.centre_in_world + hits.depth[hits.mask][:, None] * (rays @ camera.camera_from_world[:3, :3])
    towards = camera.centre_in_world - places
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    image = np.full((*hits.mask.shape, 3), 30.0)
    painted = paint(places, renderer.mesh.face_normals()[hits.face[hits.mask]], towards)
    image[hits.mask] = painted if painted.ndim == 2 else painted[:, None]
    image = np.clip(np.rint(image + random.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)
    return MemoryView(camera, Path(camera.name), None, hits.mask, image)
