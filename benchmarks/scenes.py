"""The fixed, seeded scenes that the kernels are measured on: a bumpy ball of surfels or of voxels, and a cloud of surfels.

The sizes and opacities of the surfels, and the levels and densities of the voxels, are those of trained models: at the usual
size, about 20,000 surfels or 140,000 voxels, seen in a crop of 160 x 160 pixels in the first, coarse half of a training and
in one of 320 x 320 in the second.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from surfel_reference import render_reference as surfel_reference
from voxel_reference import render_reference as voxel_reference
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.svraster import render as voxel_render
from zeroshop_steps.surface.svraster.octree import Octree
from zeroshop_steps.surface.svraster.renderers import Renderer as VoxelRenderer
from zeroshop_steps.surface.svraster.renderers import make_renderer as make_voxel_renderer
from zeroshop_steps.surface.twodgs import render as surfel_render
from zeroshop_steps.surface.twodgs.renderers import Renderer as SurfelRenderer
from zeroshop_steps.surface.twodgs.renderers import make_renderer as make_surfel_renderer
from zeroshop_steps.surface.twodgs.surfels import quaternions_towards

DISTANCE, RADIUS = 3.0, 0.8
NEAR, FAR = 1.0, 5.0
SURFEL_DEGREE, VOXEL_DEGREE = 2, 1


def look_at(azimuth: float, edge_px: int) -> Camera:
    """A square view from one side, a little from above, which the ball nearly fills."""
    centre = DISTANCE * np.array([np.cos(azimuth) * np.cos(0.5), np.sin(azimuth) * np.cos(0.5), np.sin(0.5)])
    forward = -centre / DISTANCE
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ centre
    focal_px = 1.6 * edge_px
    intrinsics = np.array([[focal_px, 0, edge_px / 2], [0, focal_px, edge_px / 2], [0, 0, 1]])
    return Camera(f"{azimuth:.2f}", edge_px, edge_px, intrinsics, camera_from_world)


def bumpy_radius(directions: np.ndarray) -> np.ndarray:
    """(N,) distance of the ball's surface from its centre in (N, 3) directions."""
    return RADIUS * (1.0 + 0.05 * np.sin(7.0 * directions).sum(1))


@dataclass(frozen=True)
class SurfelScene:
    """Surfels and views of them; `tensors` are the arguments of `render.render` before the degree."""

    name: str
    tensors: list[torch.Tensor]
    cameras: list[Camera]

    renderer: SurfelRenderer = surfel_render.CPU_RENDERER

    title = "2dgs"

    def __len__(self) -> int:
        return len(self.tensors[0])

    def on_device(self) -> "SurfelScene":
        """The same on the CUDA device."""
        renderer = make_surfel_renderer("cuda")
        tensors = [tensor.detach().to(renderer.device).requires_grad_() for tensor in self.tensors]
        return replace(self, tensors=tensors, renderer=renderer)

    def view(self, index: int) -> surfel_render.RenderView:
        return surfel_render.RenderView.from_camera(self.cameras[index], NEAR, FAR)

    def render(self, view: surfel_render.RenderView) -> list[torch.Tensor]:
        r = surfel_render.render(*self.tensors, SURFEL_DEGREE, view, renderer=self.renderer)
        return [r.color, r.depth, r.normal, r.alpha]

    def twin(self, view: surfel_render.RenderView) -> list[torch.Tensor]:
        camera = torch.tensor(view.camera, dtype=torch.float32)
        planes, _ = surfel_reference(*self.tensors, SURFEL_DEGREE, camera, view.width_px, view.height_px, view.near, view.depth_map)
        return [planes[0:3], planes[3], planes[4:7], planes[7]]


def ball_of_surfels(name: str, count: int, edge_px: int, views: int = 1) -> SurfelScene:
    """Surfels roughly along the surface, several layers deep, half of them more than half opaque."""
    rng = np.random.default_rng(count)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    positions = directions * (bumpy_radius(directions) + rng.normal(0.0, 0.01, count))[:, None]
    log_scales = np.log(0.0175 * np.sqrt(20_000 / count)) + rng.normal(0.0, 0.4, (count, 2))
    normals = directions + rng.normal(0.0, 0.25, (count, 3))
    quaternions = quaternions_towards(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    quaternions += rng.normal(0.0, 0.05, (count, 4))
    return _surfel_scene(name, rng, positions, log_scales, quaternions, edge_px, views)


def cloud_of_surfels(name: str, count: int, edge_px: int, views: int = 1) -> SurfelScene:
    """Surfels anywhere in the ball, in random directions."""
    rng = np.random.default_rng(count)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    positions = directions * RADIUS * rng.uniform(size=(count, 1)) ** (1 / 3)
    log_scales = np.log(0.02) + rng.normal(0.0, 0.4, (count, 2))
    return _surfel_scene(name, rng, positions, log_scales, rng.normal(size=(count, 4)), edge_px, views)


def _surfel_scene(name, rng, positions, log_scales, quaternions, edge_px, views) -> SurfelScene:
    count = len(positions)
    arrays = (positions, log_scales, quaternions, rng.normal(0.0, 1.0, count), rng.normal(0.0, 0.3, (count, 16, 3)))
    tensors = [torch.tensor(array, dtype=torch.float32, requires_grad=True) for array in arrays]
    return SurfelScene(name, tensors, [look_at(2.4 * index, edge_px) for index in range(views)])


@dataclass(frozen=True)
class VoxelScene:
    """Voxels and views of them; `tensors` are densities and colours."""

    name: str
    octree: Octree
    tensors: list[torch.Tensor]
    cameras: list[Camera]

    renderer: VoxelRenderer = voxel_render.CPU_RENDERER

    title = "svraster"

    def __len__(self) -> int:
        return len(self.octree)

    def on_device(self) -> "VoxelScene":
        """The same on the CUDA device."""
        renderer = make_voxel_renderer("cuda")
        tensors = [tensor.detach().to(renderer.device).requires_grad_() for tensor in self.tensors]
        return replace(self, tensors=tensors, renderer=renderer)

    def view(self, index: int) -> voxel_render.RenderView:
        return voxel_render.RenderView.from_camera(self.cameras[index])

    def render(self, view: voxel_render.RenderView) -> list[torch.Tensor]:
        r = voxel_render.render(self.octree, *self.tensors, VOXEL_DEGREE, view, self.renderer)
        return [r.color, r.depth, r.normal, r.alpha]

    def twin(self, view: voxel_render.RenderView) -> list[torch.Tensor]:
        camera = torch.tensor(view.camera, dtype=torch.float32)
        planes, _ = voxel_reference(self.octree, *self.tensors, VOXEL_DEGREE, camera, view.width_px, view.height_px, view.near)
        return [planes[0:3], planes[3], planes[4:7], planes[7]]


def ball_of_voxels(name: str, level: int, edge_px: int, views: int = 1) -> VoxelScene:
    """Leaves of two levels in a shell around the surface, thin before it and dense behind it."""
    rng = np.random.default_rng(level)
    edge = 2.0 / (1 << level)
    axis = (np.arange(1 << level) + 0.5) * edge - 1.0
    slabs = (np.stack(np.meshgrid(x, axis, axis, indexing="ij"), -1)[0] for x in axis)
    octree = Octree.uniform(np.stack([np.abs(_height(slab.reshape(-1, 3))).reshape(slab.shape[:2]) < edge for slab in slabs]))
    octree, _ = octree.refine(np.ones(len(octree), bool), rng.uniform(size=len(octree)) < 0.17)
    corners = octree.corner_points * (2.0 / 1024) - 1.0
    densities = np.clip(-1.0 - 2.5 / edge * _height(corners), -6.0, 6.0) + rng.normal(0.0, 1.5, len(corners))
    arrays = (densities, rng.normal(0.0, 0.3, (len(octree), (VOXEL_DEGREE + 1) ** 2, 3)))
    tensors = [torch.tensor(array, dtype=torch.float32, requires_grad=True) for array in arrays]
    return VoxelScene(name, octree, tensors, [look_at(2.4 * index, edge_px) for index in range(views)])


def _height(points: np.ndarray) -> np.ndarray:
    """(N,) distance of (N, 3) points beyond the surface, along the ray from the centre."""
    length = np.linalg.norm(points, axis=1)
    return length - bumpy_radius(points / np.maximum(length, 1e-9)[:, None])
