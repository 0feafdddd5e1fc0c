"""A small printed carton on a table, photographed by ten cameras: everything that `register` hands to `finish`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.cameras import Camera
from zeroshop_steps.finish.atlas import fill_gutters, rasterize
from zeroshop_steps.meshes import Mesh

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
    texels = rasterize(mesh, size)
    points = (mesh.vertices[mesh.faces[texels.face]] * texels.barycentric[:, :, None]).sum(1)
    waves = np.sin(points @ np.array([[0.25, 0.0, 0.1], [0.0, 0.3, 0.1], [0.1, 0.1, 0.2]]))
    texture = np.zeros((size, size, 3), np.uint8)
    texture[texels.row, texels.column] = 128 + 80 * waves
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
