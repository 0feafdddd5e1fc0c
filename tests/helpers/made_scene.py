"""A carton on a plain ground: its cameras, true depth, masks and blank pictures, for networks that are told the truth."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.ndimage import map_coordinates

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.runtime.open3d_loader import o3d

SIZE_MM = (120.0, 80.0, 160.0)
GROUND_MM = 900.0


@dataclass(frozen=True)
class MadeScene:
    """Cameras in mm, z up, the ground at z = 0; depth along the optical axis, 0 where nothing is; masks of the carton."""

    cameras: list[Camera]
    depths: list[np.ndarray]
    masks: list[np.ndarray]

    def image_set(self, folder: Path) -> ImageSet:
        """Write the pictures, grey, and the masks."""
        for camera, mask in zip(self.cameras, self.masks, strict=True):
            write_image(folder / "images" / camera.name, np.where(mask, 200, 90).astype(np.uint8)[..., None].repeat(3, axis=2))
            write_mask(folder / "masks" / camera.name, mask)
        names = [camera.name for camera in self.cameras]
        sizes = tuple((camera.width_px, camera.height_px) for camera in self.cameras)
        return ImageSet(tuple(folder / "images" / name for name in names), tuple(folder / "masks" / name for name in names), sizes)

    def paint(self, folder: Path) -> None:
        """Print the carton in the pictures of `image_set`: blots of some 8 mm, alike nowhere."""
        blots = np.random.default_rng(0).uniform(0, 255, (60, 60, 60))
        for camera, depth, mask in zip(self.cameras, self.depths, self.masks, strict=True):
            rows, columns = np.nonzero(mask)
            pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
            local = pixels @ np.linalg.inv(camera.intrinsics).T * depth[rows, columns, None]
            world = (local - camera.camera_from_world[:3, 3]) @ camera.camera_from_world[:3, :3]
            grey = np.full(mask.shape, 90.0)
            grey[rows, columns] = map_coordinates(blots, (world / 8.0 + 20.0).T, order=1)
            write_image(folder / "images" / camera.name, grey.astype(np.uint8)[..., None].repeat(3, axis=2))


def made_scene(
    azimuths_deg: list[float], elevations_deg: list[float], with_carton: bool = True, width_px: int = 192, height_px: int = 144
) -> MadeScene:
    """Cameras 700 mm from the carton's middle that look at it."""
    boxes = [trimesh.creation.box((GROUND_MM, GROUND_MM, 2.0), trimesh.transformations.translation_matrix((0, 0, -1.0)))]
    if with_carton:
        boxes.append(trimesh.creation.box(SIZE_MM, trimesh.transformations.translation_matrix((0, 0, SIZE_MM[2] / 2))))
    scene = o3d.t.geometry.RaycastingScene()
    for box in boxes:
        scene.add_triangles(o3d.core.Tensor(np.asarray(box.vertices, np.float32)), o3d.core.Tensor(np.asarray(box.faces, np.uint32)))
    cameras = [
        _camera(f"{number:06d}.png", azimuth, elevation, width_px, height_px)
        for number, (azimuth, elevation) in enumerate(zip(azimuths_deg, elevations_deg, strict=True))
    ]
    cast = [_cast(scene, camera) for camera in cameras]
    return MadeScene(cameras, [depth for depth, _ in cast], [mask for _, mask in cast])


def _cast(scene, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    columns, rows = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    k, pose = camera.intrinsics, camera.camera_from_world
    rays = np.stack([(columns - k[0, 2]) / k[0, 0], (rows - k[1, 2]) / k[1, 1], np.ones_like(columns)], axis=-1) @ pose[:3, :3]
    lines = np.concatenate([np.broadcast_to(camera.centre_in_world, rays.shape), rays], axis=-1).astype(np.float32)
    answer = scene.cast_rays(o3d.core.Tensor(lines))
    depth = answer["t_hit"].numpy().astype(np.float64)
    return np.where(np.isfinite(depth), depth, 0.0), answer["geometry_ids"].numpy() == 1


def _camera(name: str, azimuth_deg: float, elevation_deg: float, width_px: int, height_px: int) -> Camera:
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    outwards = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    x = np.cross(-outwards, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(-outwards, x), -outwards])
    pose[:3, 3] = -pose[:3, :3] @ (outwards * 700.0 + [0.0, 0.0, SIZE_MM[2] / 2])
    focal = 1.4 * width_px
    return Camera(name, width_px, height_px, np.array([[focal, 0, width_px / 2], [0, focal, height_px / 2], [0, 0, 1.0]]), pose)
