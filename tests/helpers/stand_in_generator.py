"""In place of Trellis: a generator that knows the true shape and returns it deformed, turned, and in its own unit cube."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import sample_texture
from zeroshop_steps.networks.trellis.flexible_surface import ColoredSurface


@dataclass(frozen=True)
class Deformation:
    """How a generated shape differs from the true one.

    Attributes:
        stretch: relative change of the three sides.
        bend: sideways shift of the middle, in heights of the object.
        color_noise: of 1; and brightness: by which all colours are multiplied.
    """

    stretch: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bend: float = 0.0
    color_noise: float = 0.0
    brightness: float = 1.0


@dataclass
class StandInGenerator:
    """Gives the deformed true mesh of each seed; remembers where it put it.

    Attributes:
        truth: textured, in the frame of the cameras, z up.
        deformations: one for each seed.
        upright: whether the mesh is turned about z alone, as Trellis does; else anyhow.
    """

    truth: Mesh
    deformations: tuple[Deformation, ...]
    upright: bool = True

    def deformed(self, seed: int) -> Mesh:
        """The deformed mesh where the true one is."""
        how = self.deformations[seed]
        low, high = self.truth.vertices.min(0), self.truth.vertices.max(0)
        around = self.truth.vertices - (low + high) / 2
        moved = around * (1 + np.array(how.stretch))
        moved[:, 0] += how.bend * (high - low)[2] * np.cos(np.pi * around[:, 2] / (high - low)[2])
        return Mesh(moved + (low + high) / 2, self.truth.faces)

    def __call__(self, seed: int) -> ColoredSurface:
        rng = np.random.default_rng(seed)
        vertices = self.deformed(seed).vertices
        turn = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True) if self.upright else Rotation.random(rng=rng)
        vertices = turn.apply(vertices - vertices.mean(0))
        vertices /= np.ptp(vertices, axis=0).max() * 1.05
        colors = sample_texture(self.truth.texture_image, self.truth.texture_coordinates) / 255.0
        how = self.deformations[seed]
        colors = np.clip(colors * how.brightness + rng.normal(0, how.color_noise, colors.shape), 0, 1)
        return ColoredSurface(vertices + rng.normal(0, 0.01, 3), self.truth.faces, colors)
