"""How much of the true surface views have measured, of what the arm can measure at all."""

from collections.abc import Iterable

import numpy as np

from zeroshop_steps.geometry.alignment.surface_distance import sample_surface
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.simulate.arm.scan_scene import PROJECTOR_M, ScanScene
from zeroshop_steps.synthetic.rendering.depth_sensor import GRAZING_COSINE

SAMPLES = 20000  # of the true surface: a share of 98 % is then exact to 0.1 %
MEASURED_M = 0.003  # a pixel whose depth is nearer to a point's than this has measured it
LEAST_SEEN = 3
"""Viewpoints that must see a point for it to count: what fewer of about 190 see, in a gap or behind an edge, is measured by luck."""
OFF_SURFACE_M = 0.0002  # that rays end before a point, so that its own face does not hide it


class TrueSurface:
    """Points of the true surface.

    Args:
        scene: the model on its table.
        viewpoints: all cameras that can be reached, in the world.
        seed: of the samples.
    """

    def __init__(self, scene: ScanScene, viewpoints: Iterable[Camera], seed: int = 0) -> None:
        mesh = Mesh(scene.points_m, scene.mesh.faces)
        self._points, faces = sample_surface(mesh, SAMPLES, np.random.default_rng(seed))
        self._normals = mesh.face_normals()[faces]
        self._scene = scene
        counts = np.zeros(len(self._points), int)
        for camera in viewpoints:
            counts += self.sees(camera)
        # What is nearer to the table than depth is exact cannot be told from it.
        self.measurable = (counts >= LEAST_SEEN) & (self._points[:, 2] > MEASURED_M)

    def sees(self, camera: Camera) -> np.ndarray:
        """(P,) bool: the points that the sensor can measure from a camera, by its own rules and without its noise."""
        _, _, _, inside = camera.find_pixels(self._points)
        rays = camera.centre_in_world - self._points
        cosine = (self._normals * rays).sum(1) / np.linalg.norm(rays, axis=1)
        seen = inside & (cosine > GRAZING_COSINE)
        projector = camera.centre_in_world + camera.camera_from_world[:3, :3].T @ PROJECTOR_M
        for eye in (camera.centre_in_world, projector):
            seen &= ~self._is_hidden_from(eye)
        return np.asarray(seen)

    def measured(self, camera: Camera, depth_m: np.ndarray) -> np.ndarray:
        """(P,) bool: the points that a (height, width) depth image of a camera measured."""
        rows, columns, depth, inside = camera.find_pixels(self._points)
        found = np.zeros(len(self._points), bool)
        found[inside] = np.abs(depth_m[rows[inside], columns[inside]] - depth[inside]) < MEASURED_M
        return found

    def share(self, measured: np.ndarray) -> float:
        """Completeness, 0..1, by (P,) bool."""
        return float(measured[self.measurable].mean())

    def _is_hidden_from(self, eye_m: np.ndarray) -> np.ndarray:
        ends = self._points + OFF_SURFACE_M * self._normals
        starts = np.broadcast_to(eye_m, ends.shape)
        rays = MM_PER_M * np.concatenate([starts - self._scene.world_from_model_m, ends - starts], 1)
        return np.asarray(self._scene.rays.test_occlusions(o3d.core.Tensor(rays.astype(np.float32)), 0.0, 1.0).numpy())
