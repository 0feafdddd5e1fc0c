"""Colour of ray hits: texture, baked light and the highlights of the area lights."""

import math
from typing import NamedTuple

import numba
import numpy as np

from zeroshop_steps.synthetic.rendering.textures import sample_mip_levels

# The look of matt print (a choice): how much is mirrored straight on and at a grazing angle (Schlick 1994), and how widely.
NORMAL_REFLECTANCE = 0.03
GRAZING_REFLECTANCE = 0.3
ROUGHNESS = 0.25  # standard deviation of the mirrored directions, as a slope
BUMP_CONTRAST = 2.0  # how much darker an uneven ground is where it is inclined
LEAST_TOWARDS = 0.05  # cosine between the mirrored direction and a light's axis; beyond, its highlight is left out
MISS = np.uint32(0xFFFFFFFF)  # what Open3D calls a ray that hit nothing
BLOCK = 2048  # rays of a thread at a time


def use_threads(threads: int) -> None:
    """Let the shading kernels use this many threads, at most the machine's; 0 for all."""
    if threads > 0:
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))


class SceneMeshArrays(NamedTuple):
    """A `SceneMesh` for the kernel: corners, normals (F, 3, 3) and uv (F, 3, 2) by face, and its pyramid's fields."""

    corners: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    texels: np.ndarray
    levels: np.ndarray
    wrap: bool


class LightArrays(NamedTuple):
    """The fields of `Lights` and `BakedLight` for the kernel; `background` is the radiance of what no ray hits."""

    centres: np.ndarray
    axes: np.ndarray
    half_side: float
    radiances: np.ndarray
    sky: float
    background: float
    object_first: np.ndarray
    object_steps: np.ndarray
    object_light: np.ndarray
    surface_light: np.ndarray
    surface_origin: np.ndarray
    surface_side: float


@numba.njit(cache=True, parallel=True)
def make_camera_rays(pixels, intrinsics, world_from_camera):
    """(N, 6) float32 rays (origin, direction of unit z in the camera) through (N, 2) pixel positions, so that t is the z depth."""
    rays = np.empty((pixels.shape[0], 6), np.float32)
    for index in numba.prange(pixels.shape[0]):
        x = (pixels[index, 0] - intrinsics[0, 2]) / intrinsics[0, 0]
        y = (pixels[index, 1] - intrinsics[1, 2]) / intrinsics[1, 1]
        for k in range(3):
            rays[index, k] = world_from_camera[k, 3]
            rays[index, 3 + k] = world_from_camera[k, 0] * x + world_from_camera[k, 1] * y + world_from_camera[k, 2]
    return rays


@numba.njit(cache=True, forceinline=True, fastmath=True)
def _highlight(point, mirrored, lights, visible):
    """Radiance of the lights around the mirrored direction: each square convolved with a Gaussian lobe of width ROUGHNESS."""
    centres, axes, half_side = lights.centres, lights.axes, lights.half_side
    total = 0.0
    for light in range(6):
        towards = 0.0
        for k in range(3):
            towards -= mirrored[k] * axes[light, 2, k]
        if towards <= LEAST_TOWARDS or visible[1 + light] <= 0.0:
            continue
        distance = 0.0
        for k in range(3):
            distance -= (centres[light, k] - point[k]) * axes[light, 2, k]
        t = distance / towards
        if t <= 0.0:
            continue
        a, b = 0.0, 0.0
        for k in range(3):
            offset = point[k] + t * mirrored[k] - centres[light, k]
            a += offset * axes[light, 0, k]
            b += offset * axes[light, 1, k]
        width = ROUGHNESS * t * 1.4142135
        share_a = 0.5 * (math.erf((a + half_side) / width) - math.erf((a - half_side) / width))
        share_b = 0.5 * (math.erf((b + half_side) / width) - math.erf((b - half_side) / width))
        total += lights.radiances[light] * visible[1 + light] * share_a * share_b
    return total


@numba.njit(cache=True, forceinline=True, fastmath=True)
def _footprint(corners, uvs, bu, bv, direction, reach, step_x, step_y):
    """Texture coordinates of a hit and their change over one pixel to the right and one down (u, v, ux, vx, uy, vy).

    The pixel's footprint on the face's plane (Igehy 1999), taken into texture space by the face's own linear map. `reach` is
    the depth times the side of the footprint in pixels.
    """
    e1x, e1y, e1z = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    e2x, e2y, e2z = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    gx, gy, gz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
    along = direction[0] * gx + direction[1] * gy + direction[2] * gz
    if abs(along) < 1e-9:
        along = 1e-9
    shift_x = (step_x[0] * gx + step_x[1] * gy + step_x[2] * gz) / along
    shift_y = (step_y[0] * gx + step_y[1] * gy + step_y[2] * gz) / along
    xx, xy, xz = step_x[0] - direction[0] * shift_x, step_x[1] - direction[1] * shift_x, step_x[2] - direction[2] * shift_x
    yx, yy, yz = step_y[0] - direction[0] * shift_y, step_y[1] - direction[1] * shift_y, step_y[2] - direction[2] * shift_y
    d11, d12, d22 = e1x * e1x + e1y * e1y + e1z * e1z, e1x * e2x + e1y * e2y + e1z * e2z, e2x * e2x + e2y * e2y + e2z * e2z
    scale = reach / max(d11 * d22 - d12 * d12, 1e-20)
    x1, x2 = (xx * e1x + xy * e1y + xz * e1z) * scale, (xx * e2x + xy * e2y + xz * e2z) * scale
    y1, y2 = (yx * e1x + yy * e1y + yz * e1z) * scale, (yx * e2x + yy * e2y + yz * e2z) * scale
    xu, xv, yu, yv = d22 * x1 - d12 * x2, d11 * x2 - d12 * x1, d22 * y1 - d12 * y2, d11 * y2 - d12 * y1
    u1, u2 = uvs[1, 0] - uvs[0, 0], uvs[2, 0] - uvs[0, 0]
    v1, v2 = uvs[1, 1] - uvs[0, 1], uvs[2, 1] - uvs[0, 1]
    u, v = uvs[0, 0] + bu * u1 + bv * u2, uvs[0, 1] + bu * v1 + bv * v2
    return u, v, xu * u1 + xv * u2, xu * v1 + xv * v2, yu * u1 + yv * u2, yu * v1 + yv * v2


@numba.njit(cache=True, forceinline=True, fastmath=True)
def _object_light(lights, face, bu, bv, light):
    """Interpolate the seven light channels on a face's lattice into `light`."""
    steps = lights.object_steps[face]
    i, j = min(int(bu * steps), steps - 1), min(int(bv * steps), steps - 1)
    if i + j > steps - 1:
        j = steps - 1 - i
    fi, fj = bu * steps - i, bv * steps - j
    base = lights.object_first[face] + i * (steps + 1) - i * (i - 1) // 2 + j
    right = lights.object_first[face] + (i + 1) * (steps + 1) - (i + 1) * i // 2 + j
    samples = lights.object_light
    if fi + fj > 1.0 and i + j < steps - 1:
        for k in range(light.shape[0]):
            light[k] = (fi + fj - 1.0) * samples[right + 1, k] + (1.0 - fj) * samples[right, k] + (1.0 - fi) * samples[base + 1, k]
    else:
        for k in range(light.shape[0]):
            light[k] = (1.0 - fi - fj) * samples[base, k] + fi * samples[right, k] + fj * samples[base + 1, k]


@numba.njit(cache=True, forceinline=True, fastmath=True)
def _surface_light(lights, px, py):
    """Irradiance / pi of the surface at a place (mm), between its grid's samples; beyond the grid that of its border."""
    samples = lights.surface_light
    cells = samples.shape[0]
    x = min(max((px - lights.surface_origin[0]) / lights.surface_side * cells - 0.5, 0.0), cells - 1.001)
    y = min(max((py - lights.surface_origin[1]) / lights.surface_side * cells - 0.5, 0.0), cells - 1.001)
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    below = (1 - fx) * samples[j, i, 0] + fx * samples[j, i + 1, 0]
    above = (1 - fx) * samples[j + 1, i, 0] + fx * samples[j + 1, i + 1, 0]
    return (1 - fy) * below + fy * above


@numba.njit(cache=True, forceinline=True, fastmath=True)
def _shine(lights, point, normal, direction, light):
    """Radiance mirrored towards the camera by the object's mild gloss (Schlick's Fresnel term); all vectors are of unit length."""
    cosine = -(normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2])
    if cosine <= 0.0:
        return 0.0
    for k in range(3):
        direction[k] += 2.0 * cosine * normal[k]
    reflectance = NORMAL_REFLECTANCE + (GRAZING_REFLECTANCE - NORMAL_REFLECTANCE) * (1.0 - cosine) ** 5
    return reflectance * (_highlight(point, direction, lights, light) + lights.sky * min(light[0], 1.0))


@numba.njit(cache=True, parallel=True, fastmath=True)
def shade(rays, depths, geometry, faces, barycentric, step_x, step_y, footprint, thing, surface, lights, linear_of_byte):
    """Linear RGB (N, 3) of N hits.

    Args:
        rays: (N, 6) origins and directions, see `make_camera_rays`.
        depths, geometry, faces, barycentric: what the ray cast returned (geometry 0 the object, 1 the surface, else a miss).
        step_x, step_y: (3,) change of the ray direction over one pixel to the right and one down.
        footprint: side of the filtered footprint in pixels.
        thing, surface: `SceneMeshArrays` of the object and of the surface it stands on.
        lights: `LightArrays`.
        linear_of_byte: (256,) decoding table of the textures.
    """
    out = np.empty((rays.shape[0], 3), np.float32)
    for block in numba.prange((rays.shape[0] + BLOCK - 1) // BLOCK):
        point, direction, normal, light = np.empty(3), np.empty(3), np.empty(3), np.empty(7)
        for index in range(block * BLOCK, min((block + 1) * BLOCK, rays.shape[0])):
            part, face = geometry[index], faces[index]
            length = math.sqrt(rays[index, 3] ** 2 + rays[index, 4] ** 2 + rays[index, 5] ** 2)
            if part > 1:
                value = lights.background * (0.85 + 0.3 * rays[index, 5] / length)
                out[index, 0], out[index, 1], out[index, 2] = value, value, value
                continue
            shape = thing if part == 0 else surface
            bu, bv = barycentric[index, 0], barycentric[index, 1]
            for k in range(3):
                direction[k] = rays[index, 3 + k]
                point[k] = rays[index, k] + depths[index] * direction[k]
                normal[k] = (1.0 - bu - bv) * shape.normals[face, 0, k] + bu * shape.normals[face, 1, k] + bv * shape.normals[face, 2, k]
            reach = depths[index] * footprint
            u, v, ux, vx, uy, vy = _footprint(shape.corners[face], shape.uv[face], bu, bv, direction, reach, step_x, step_y)
            red, green, blue = sample_mip_levels(shape.texels, shape.levels, shape.wrap, linear_of_byte, u, v, ux, vx, uy, vy)
            size = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
            for k in range(3):
                normal[k] /= size
                direction[k] /= length
            shine = 0.0
            if part == 0:
                _object_light(lights, face, bu, bv, light)
                diffuse, shine = light[0], _shine(lights, point, normal, direction, light)
            else:
                diffuse = _surface_light(lights, point[0], point[1]) * (1.0 - BUMP_CONTRAST * (1.0 - normal[2]))
            out[index, 0] = red * diffuse + shine
            out[index, 1] = green * diffuse + shine
            out[index, 2] = blue * diffuse + shine
    return out
