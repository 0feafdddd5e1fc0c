"""What the camera on the hand sees of a model on a table: photos by our ray caster, depth with a structured-light sensor's errors."""

from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.surface_parts import with_texture
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import M_PER_MM, MM_PER_M
from zeroshop_steps.runtime.open3d_loader import ray_caster
from zeroshop_steps.scan.workspace import Box
from zeroshop_steps.synthetic.rendering.depth_sensor import PROJECTOR_MM, take_depth_image
from zeroshop_steps.synthetic.rendering.renderer import SceneRenderer, expose
from zeroshop_steps.synthetic.scenes.scene_meshes import make_object_mesh, make_surface_mesh
from zeroshop_steps.synthetic.virtual_capture import measure_bounds

PROJECTOR_M = PROJECTOR_MM * M_PER_MM
"""(3,) of the simulated sensor, along the camera's axes."""
MARGIN_M = 0.03  # that the box around the object is larger on each side: about what a person measures it to


class ScanScene:
    """A model that stands on a richly textured table.

    Args:
        mesh: in millimetres, upright, z up.
        name: of its file, for messages.
        distance_m: from the arm's base, along x of the world, to the middle of the model.
        seed: of the table.
    """

    def __init__(self, mesh: Mesh, name: Path, distance_m: float, seed: int = 0) -> None:
        self.mesh, self._seed = with_texture(mesh), seed
        self._bounds = measure_bounds(mesh, name, 0.0)
        middle = np.append(self._bounds.centre_mm[:2], self._bounds.bottom_mm)
        self.world_from_model_m = np.array([distance_m, 0.0, 0.0]) - M_PER_MM * middle
        self._parts = [make_object_mesh(self.mesh)]
        table = make_surface_mesh("su_h", self._bounds, seed)
        assert table is not None, "this scene has a surface"
        self._parts.append(table)
        self.rays = ray_caster(*((part.vertices, part.faces) for part in self._parts))

    @property
    def points_m(self) -> np.ndarray:
        """(V, 3) vertices of the object in the world."""
        return np.asarray(self.mesh.vertices * M_PER_MM + self.world_from_model_m)

    @property
    def box(self) -> Box:
        """What a user states of the object: a box around it, `MARGIN_M` larger, that stands on the table."""
        low, high = self.points_m.min(0) - MARGIN_M, self.points_m.max(0) + MARGIN_M
        return Box(np.append(low[:2], 0.0), high)

    def depth_m(self, camera: Camera, rng: np.random.Generator) -> np.ndarray:
        """(height, width) float32 that the sensor measures from a camera in the world, metres; 0 where nothing."""
        _, measured = take_depth_image(self.rays, self.in_model(camera), rng)
        return np.asarray(measured * np.float32(M_PER_MM))

    def photo(self, camera: Camera, rng: np.random.Generator) -> np.ndarray:
        """(height, width, 3) uint8 from a camera in the world."""
        return expose(self._renderer.render(self.in_model(camera)).linear, rng)

    def in_model(self, camera: Camera) -> Camera:
        """A camera in the world, in metres, as a camera about the model, in millimetres."""
        pose = camera.camera_from_world.copy()
        pose[:3, 3] = MM_PER_M * (pose[:3, 3] + pose[:3, :3] @ self.world_from_model_m)
        return replace(camera, camera_from_world=pose)

    @cached_property
    def _renderer(self) -> SceneRenderer:
        return SceneRenderer(self._parts, self._bounds, self._seed)
