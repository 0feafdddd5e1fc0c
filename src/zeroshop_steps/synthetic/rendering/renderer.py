"""The embedded ray caster: Open3D finds what each ray hits, the shading kernel gives it a colour."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.triangle_meshes import SAME_SIDE_COSINE
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster
from zeroshop_steps.synthetic.rendering import lighting, shading
from zeroshop_steps.synthetic.rendering.textures import LINEAR_OF_BYTE, encode_srgb
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds
from zeroshop_steps.synthetic.scenes.scene_meshes import SceneMesh

EDGE_FOOTPRINT = 0.6  # pixels that a sample at an edge takes its texture from; the sixteen of a pixel overlap
EDGE_LEAP = 0.02  # of the depth, between neighbours, above which there is an edge
BACKGROUND = 0.45  # linear light at the horizon
# The noise of a photo, in linear light from 0 to 1.
FULL_WELL_ELECTRONS = 9000.0  # behind a white pixel: its signal is 95 times its shot noise
READ_NOISE = 6e-4  # standard deviation


@dataclass(frozen=True)
class RenderedView:
    """One rendered view.

    Attributes:
        linear: (height, width, 3) float32 linear light.
        mask: (height, width) bool, at least half of the pixel is object.
        depth_mm: (height, width) float32 z depth of the scene, 0 where nothing was hit.
    """

    linear: np.ndarray
    mask: np.ndarray
    depth_mm: np.ndarray


class SceneRenderer:
    """Renders a scene of an object (`parts[0]`) and perhaps a surface (`parts[1]`); the light is baked once, here.

    `lights` are those of the captures by default; for `merged_mm` and `surface_cells` see `lighting.bake_light`. `mirror` is the
    reflectance of the flat surface's varnish at normal incidence: above 0, the surface shows a mirror image of what stands on it.
    """

    def __init__(
        self,
        parts: list[SceneMesh],
        bounds: ObjectBounds,
        seed: int,
        lights: lighting.Lights | None = None,
        merged_mm: float | None = None,
        mirror: float = 0.0,
        surface_cells: int | None = None,
    ) -> None:
        self.scene = ray_caster(*((part.vertices, part.faces) for part in parts))
        self._mirror, self._surface_mm = mirror, bounds.bottom_mm
        self._mirrored_scene = ray_caster((parts[0].vertices, parts[0].faces)) if mirror else None
        lights = lights or lighting.place_lights(bounds, on_surface=len(parts) > 1)
        light = lighting.bake_light(self.scene, parts, bounds, lights, seed, merged_mm, surface_cells)
        self._arrays = [
            shading.SceneMeshArrays(
                part.vertices[part.faces], part.corner_normals, part.corner_uv, part.pyramid.texels, part.pyramid.levels, part.pyramid.wrap
            )
            for part in (parts[0], parts[-1])
        ]
        self._light_arrays = shading.LightArrays(
            lights.centres, lights.axes, lights.half_side_mm, lights.radiances, lights.sky, BACKGROUND if len(parts) > 1 else 0.0,
            light.object_first, light.object_steps, light.object_light,
            light.surface_light, light.surface_origin_mm, light.surface_side_mm,
        )  # fmt: skip

    def render(self, camera: Camera) -> RenderedView:
        """Render one view: one filtered sample a pixel, and sixteen where geometry changes within a pixel's reach."""
        height, width = camera.height_px, camera.width_px
        pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1).reshape(-1, 2)
        color, part, depth, normals = self._trace(camera, pixels, 1.0)
        object_share = (part == 0).astype(np.float32)
        edges = np.flatnonzero(_find_edges(part.reshape(height, width), depth.reshape(height, width), normals.reshape(height, width, 3)))
        count = 4
        offsets = np.stack(np.meshgrid(*2 * [(np.arange(count) + 0.5) / count - 0.5]), -1).reshape(-1, 2)
        if len(edges):
            sub_color, sub_part, sub_depth, _ = self._trace(camera, (pixels[edges, None] + offsets).reshape(-1, 2), EDGE_FOOTPRINT)
            shape = (len(edges), len(offsets))
            color[edges] = sub_color.reshape(*shape, 3).mean(1)
            is_object = sub_part.reshape(shape) == 0
            object_share[edges] = is_object.mean(1)
            wanted = is_object == (is_object.mean(1) >= 0.5)[:, None]
            wanted &= sub_depth.reshape(shape) > 0
            nearest = np.where(wanted, np.abs(sub_depth.reshape(shape) - depth[edges, None]), np.inf)
            pick = np.take_along_axis(sub_depth.reshape(shape), nearest.argmin(1)[:, None], 1)[:, 0]
            agrees = (part[edges] == 0) == (object_share[edges] >= 0.5)
            depth[edges] = np.where(agrees, depth[edges], np.where(wanted.any(1), pick, 0.0))
        mask = (object_share >= 0.5).reshape(height, width)
        return RenderedView(color.reshape(height, width, 3), mask, depth.reshape(height, width))

    def _trace(self, camera: Camera, pixels: np.ndarray, footprint: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        world_from_camera = np.linalg.inv(camera.camera_from_world)
        rays = shading.make_camera_rays(pixels, camera.intrinsics, world_from_camera)
        hits = self.scene.cast_rays(o3d.core.Tensor(rays))
        depth, part = hits["t_hit"].numpy(), hits["geometry_ids"].numpy()
        step_x = world_from_camera[:3, 0] / camera.intrinsics[0, 0]
        step_y = world_from_camera[:3, 1] / camera.intrinsics[1, 1]
        color = self._shade(rays, hits, step_x, step_y, footprint)
        if self._mirrored_scene is not None:
            on_surface = np.flatnonzero(part == 1)
            color[on_surface] = self._add_mirror_image(color[on_surface], rays[on_surface], step_x, step_y, footprint)
        return color, part, np.where(part == shading.MISS, 0.0, depth).astype(np.float32), hits["primitive_normals"].numpy()

    def _shade(self, rays: np.ndarray, hits: dict[str, Any], step_x: np.ndarray, step_y: np.ndarray, footprint: float) -> np.ndarray:
        return shading.shade(
            rays, hits["t_hit"].numpy(), hits["geometry_ids"].numpy(), hits["primitive_ids"].numpy(), hits["primitive_uvs"].numpy(),
            step_x, step_y, footprint, *self._arrays, self._light_arrays, LINEAR_OF_BYTE,
        )  # fmt: skip

    def _add_mirror_image(
        self, color: np.ndarray, rays: np.ndarray, step_x: np.ndarray, step_y: np.ndarray, footprint: float
    ) -> np.ndarray:
        """(N, 3) colours of surface points with what their varnish reflects, by Schlick's approximation of Fresnel's equations.

        The mirrored ray starts below the surface, where the camera's mirror image is, and the surface itself is not in its way.
        """
        flip = np.array([1, 1, -1], np.float32)
        mirrored = np.concatenate([rays[:, :3] * flip + np.float32(2 * self._surface_mm) * (flip < 0), rays[:, 3:] * flip], 1)
        assert self._mirrored_scene is not None, "only a mirroring surface is asked"
        hits = self._mirrored_scene.cast_rays(o3d.core.Tensor(mirrored))
        reflected = self._shade(mirrored, hits, step_x * flip, step_y * flip, footprint)
        cosine = np.abs(rays[:, 5]) / np.linalg.norm(rays[:, 3:], axis=1)
        share = (self._mirror + (1 - self._mirror) * (1 - cosine) ** 5)[:, None].astype(np.float32)
        return (1 - share) * color + share * reflected


def _find_edges(part: np.ndarray, depth: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(height, width) bool: pixels that differ from a neighbour in part or normal, or leap in depth."""
    found = np.zeros(part.shape, bool)
    for axis in (0, 1):
        ahead = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        behind = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        is_object = (part[ahead] == 0) | (part[behind] == 0)
        change = part[ahead] != part[behind]
        turned = np.abs(np.einsum("ijk,ijk->ij", normals[ahead], normals[behind])) < SAME_SIDE_COSINE
        leap = np.abs(depth[ahead] - depth[behind]) > EDGE_LEAP * np.maximum(depth[ahead], depth[behind])
        change |= is_object & (turned | leap)
        found[ahead] |= change
        found[behind] |= change
    return cv2.dilate(found.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) if found.any() else found


def expose(linear: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(height, width, 3) uint8 sRGB photograph of linear light, with shot and read noise (Poisson's as a normal distribution)."""
    light = np.clip(linear, 0.0, None)
    deviation = np.sqrt(light / FULL_WELL_ELECTRONS + READ_NOISE**2, dtype=np.float32)
    noisy = light + deviation * rng.standard_normal(light.shape, dtype=np.float32)
    return encode_srgb(noisy)
