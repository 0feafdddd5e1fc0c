"""A small printed carton on a table, photographed by ten cameras: everything that `register` hands to `height` and `finish`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
import trimesh

from zeroshop_steps.finish.texturing.atlas import fill_gutters, rasterize_atlas
from zeroshop_steps.finish.texturing.unwrap import unwrap_mesh
from zeroshop_steps.geometry.cameras.pinhole import Camera, write_cameras
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.files import write_json

SIZE_MM = np.array([60.0, 40.0, 90.0])
WIDTH_PX, HEIGHT_PX = 320, 240


@dataclass(frozen=True)
class Carton:
    """The carton's folders and its truth (object frame: z up, origin at the box's centre, first camera on +x)."""

    cameras: Path
    capture: Path
    model: Path
    mesh: Mesh


def printed(mesh: Mesh, size: int) -> np.ndarray:
    """A texture whose colours are smooth functions of the place on the object, with bands as print."""
    texels = rasterize_atlas(mesh, size)
    points = (mesh.vertices[mesh.faces[texels.face]] * texels.barycentric[:, :, None]).sum(1)
    waves = np.sin(points @ np.array([[0.25, 0.0, 0.1], [0.0, 0.3, 0.1], [0.1, 0.1, 0.2]]))
    texture = np.zeros((size, size, 3), np.uint8)
    texture[texels.row, texels.column] = 128 + 80 * waves
    return fill_gutters(texture, texels)


def finely_printed(mesh: Mesh, size: int) -> np.ndarray:
    """A texture of blobs, a tenth of an inch apart."""
    texels = rasterize_atlas(mesh, size)
    points = (mesh.vertices[mesh.faces[texels.face]] * texels.barycentric[:, :, None]).sum(1)
    rng = np.random.default_rng(7)
    waves = np.cos(points @ rng.normal(0, 0.7, (3, 40)) + rng.uniform(0, 2 * np.pi, 40)).sum(1)
    texture = np.zeros((size, size, 3), np.uint8)
    texture[texels.row, texels.column] = np.clip(128 + 14 * waves, 0, 255)[:, None]
    return fill_gutters(texture, texels)


def camera_at(name: str, azimuth_deg: float, elevation_deg: float, distance_mm: float = 260.0) -> Camera:
    """A level camera that looks at the origin; azimuth 0 lies on +x."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    outwards = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    x = np.cross(-outwards, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = np.stack([x, np.cross(-outwards, x), -outwards])
    camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ (outwards * distance_mm)
    intrinsics = np.array([[420.0, 0.0, WIDTH_PX / 2], [0.0, 420.0, HEIGHT_PX / 2], [0.0, 0.0, 1.0]])
    return Camera(name, WIDTH_PX, HEIGHT_PX, intrinsics, camera_from_world)


def table_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """Noisy points on the table, none under the box."""
    points = rng.uniform(-120.0, 120.0, (count, 3))
    points[:, 2] = -SIZE_MM[2] / 2 + rng.normal(0.0, 0.1, count)
    return points[(np.abs(points[:, :2]) > SIZE_MM[:2] / 2).any(1)]


def add_points(sparse: Path, points: np.ndarray) -> None:
    """Add sparse points to a COLMAP model."""
    reconstruction = pycolmap.Reconstruction(str(sparse))
    for point in points:
        reconstruction.add_point3D(point, pycolmap.Track(), np.zeros(3, np.uint8))
    reconstruction.write_binary(str(sparse))


def photographed_carton(folder: Path, make_print: Callable[[Mesh, int], np.ndarray] = printed) -> Carton:
    """Write the carton's model, its registered photos and its capture below `folder`."""
    box = trimesh.creation.box(SIZE_MM).subdivide().subdivide().subdivide().subdivide()
    mesh, _ = unwrap_mesh(Mesh(np.array(box.vertices), np.array(box.faces, np.int64)), 512)
    mesh = Mesh(mesh.vertices, mesh.faces, mesh.normals, mesh.uv, make_print(mesh, 512))
    cameras = [camera_at(f"{k:06d}.png", 36.0 * k, 35.0 if k % 2 else 5.0) for k in range(10)]
    held_out = [camera_at(f"{k:06d}.png", 20.0 + 170.0 * k, 20.0) for k in range(2)]
    renderer = MeshRenderer(mesh)
    for set_folder, views, sparse in ((folder / "cameras", cameras, "sparse"), (folder / "capture" / "held_out", held_out, "truth")):
        for camera in views:
            write_image(set_folder / "images" / camera.name, renderer.render_color(camera, (90, 160, 90), 3))
            write_mask(set_folder / "masks" / camera.name, renderer.render_masked_color(camera, 3)[1])
        write_cameras(set_folder / sparse, views)
    write_cameras(folder / "capture" / "truth", cameras)
    add_points(folder / "cameras" / "sparse", table_points(np.random.default_rng(1), 400))
    write_json(folder / "capture" / "capture.json", {"scene": "su_h", "known_height_m": SIZE_MM[2] / 1000})
    write_image(folder / "model" / "model.png", mesh.texture)
    write_ply(folder / "model" / "model.ply", mesh, "model.png")
    write_json(folder / "model" / "model_info.json", {"diameter": float(np.linalg.norm(SIZE_MM))})
    return Carton(folder / "cameras", folder / "capture", folder / "model" / "model.ply", mesh)
