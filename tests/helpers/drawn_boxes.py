"""A small ball beside a box, drawn from two sides, and, as a program in Numba's simulator, by the kernel for CUDA.

The simulator has to be chosen before Numba is imported: NUMBA_ENABLE_CUDASIM=1 NUMBA_DISABLE_JIT=1 python drawn_boxes.py OUT
"""

import sys

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.geometry.rendering.rasterization import PixelGrid, draw_on_device, find_pixels, rasterize
from zeroshop_steps.runtime.compute.device_arrays import tensor_device
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

WIDTH_PX, HEIGHT_PX = 48, 40
INTRINSICS = np.array([[90.0, 0.0, 25.0], [0.0, 80.0, 18.0], [0.0, 0.0, 1.0]])


def make_boxes() -> Mesh:
    """A ball and a box, which hides part of it from some sides."""
    ball = trimesh.creation.icosphere(2, 25.0).apply_translation([30, 0, 10])
    both = trimesh.util.concatenate([ball, trimesh.creation.box((40, 60, 30))])
    return Mesh(np.asarray(both.vertices), np.asarray(both.faces))


def make_cameras(away_mm: tuple[float, float, float] = (5.0, -4.0, 260.0), count: int = 2) -> list[Camera]:
    """Cameras on random sides of the boxes, which are so far away and in the middle, if nothing else is said."""
    cameras = []
    for rotation in Rotation.random(count, random_state=1):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), away_mm
        cameras.append(Camera("", WIDTH_PX, HEIGHT_PX, INTRINSICS, pose))
    return cameras


def cast(mesh: Mesh, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Face, barycentric coordinates and depth by Open3D's rays through the centres of the pixels; face -1 and depth 0 where nothing is."""
    rays = o3d.t.geometry.RaycastingScene.create_rays_pinhole(
        o3d.core.Tensor(camera.intrinsics), o3d.core.Tensor(camera.camera_from_world), camera.width_px, camera.height_px
    )
    found = ray_caster((mesh.vertices, mesh.faces)).cast_rays(rays)
    depth, face = found["t_hit"].numpy(), found["primitive_ids"].numpy().astype(np.int64)
    return np.where(np.isfinite(depth), face, -1), found["primitive_uvs"].numpy(), np.where(np.isfinite(depth), depth, 0)


def pose(mesh: Mesh, cameras: list[Camera]) -> tuple[torch.Tensor, torch.Tensor, PixelGrid]:
    """(P, V, 3) float32 points of a mesh in the cameras, (F, 3) its faces, and the cameras' pixels."""
    poses = np.array([camera.camera_from_world for camera in cameras])
    points = np.einsum("pij,vj->pvi", poses[:, :3, :3], mesh.vertices) + poses[:, None, :3, 3]
    focal, middle = np.diag(INTRINSICS)[:2], INTRINSICS[:2, 2]
    first, step = (torch.as_tensor(one, dtype=torch.float32).expand(len(cameras), 2) for one in ((0.5 - middle) / focal, 1 / focal))
    return torch.as_tensor(points, dtype=torch.float32), torch.as_tensor(mesh.faces), PixelGrid(first, step, HEIGHT_PX, WIDTH_PX)


def draw(device: str) -> dict[str, np.ndarray]:
    """What the cameras see, stacked: face, barycentric and depth; and face and shares of the rasterizer of many poses."""
    renderer = MeshRenderer(make_boxes(), device)
    found = [renderer.cast_rays(camera) for camera in make_cameras()]
    points, faces, grid = pose(make_boxes(), make_cameras())
    if device == "cpu":
        posed = rasterize(points, faces, grid)
    else:
        points, faces, first, step = (values.to(tensor_device(device)) for values in (points, faces, grid.first, grid.step))
        grid = PixelGrid(first, step, HEIGHT_PX, WIDTH_PX)
        posed = draw_on_device(*find_pixels(points, grid), faces, grid)  # the simulator's tensors lie in the host's memory
    hits = {name: np.stack([getattr(one, name) for one in found]) for name in ("face", "barycentric", "depth")}
    return hits | {"posed_face": posed.face.cpu().numpy(), "posed_shares": posed.shares.cpu().numpy()}


if __name__ == "__main__":
    np.savez(sys.argv[1], **draw("cuda"))
