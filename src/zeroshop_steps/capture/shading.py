"""Colour of ray hits: texture, baked light and the highlights of the area lights."""

import math

import numba
import numpy as np

from zeroshop_steps.capture.textures import sample

NORMAL_REFLECTANCE = 0.03
ROUGHNESS = 0.25
MISS = np.uint32(0xFFFFFFFF)


@numba.njit(cache=True, parallel=True)
def camera_rays(pixels, intrinsics, world_from_camera):
    """(N, 6) float32 rays (origin, direction of unit z in the camera) through (N, 2) pixel positions, so that t is the z depth."""
    rays = np.empty((pixels.shape[0], 6), np.float32)
    for index in numba.prange(pixels.shape[0]):
        x = (pixels[index, 0] - intrinsics[0, 2]) / intrinsics[0, 0]
        y = (pixels[index, 1] - intrinsics[1, 2]) / intrinsics[1, 1]
        for k in range(3):
            rays[index, k] = world_from_camera[k, 3]
            rays[index, 3 + k] = world_from_camera[k, 0] * x + world_from_camera[k, 1] * y + world_from_camera[k, 2]
    return rays


@numba.njit(cache=True, fastmath=True)
def _highlight(point, mirrored, centres, axes, half_side, radiances, visible):
    """Radiance of the lights around the mirrored direction: each square convolved with a Gaussian lobe of width ROUGHNESS."""
    total = 0.0
    for light in range(6):
        towards = 0.0
        for k in range(3):
            towards -= mirrored[k] * axes[light, 2, k]
        if towards <= 0.05 or visible[light] <= 0.0:
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
        total += radiances[light] * visible[light] * share_a * share_b
    return total


@numba.njit(cache=True, parallel=True, fastmath=True)
def shade(
    rays, depths, geometry, faces, barycentric, step_x, step_y, footprint,
    object_corners, object_normals, object_uv, object_texels, object_levels, object_wrap,
    surface_corners, surface_normals, surface_uv, surface_texels, surface_levels,
    linear_of_byte, light_first, light_steps, object_light, surface_light, surface_origin, surface_side,
    centres, axes, half_side, radiances, sky, background,
):  # fmt: skip
    """Linear RGB (N, 3) of N hits.

    Args:
        rays: (N, 6) origins and directions, see `camera_rays`.
        depths, geometry, faces, barycentric: what the ray cast returned (0 the object, 1 the surface, else a miss).
        step_x, step_y: (3,) change of the ray direction over one pixel to the right and one down.
        footprint: side of the filtered footprint in pixels.
        object_..., surface_...: fields of the two `Part`s, corners (F, 3, 3), and of `BakedLight`.
        centres, axes, half_side, radiances, sky: fields of `Lights`.
        background: radiance of what no ray hits, shaded by its height.
    """
    out = np.empty((rays.shape[0], 3), np.float32)
    for index in numba.prange(rays.shape[0]):
        part, face = geometry[index], faces[index]
        if part > 1:
            length = math.sqrt(rays[index, 3] ** 2 + rays[index, 4] ** 2 + rays[index, 5] ** 2)
            value = background * (0.85 + 0.3 * rays[index, 5] / length)
            out[index, 0], out[index, 1], out[index, 2] = value, value, value
            continue
        if part == 0:
            corners, normals, uvs = object_corners[face], object_normals[face], object_uv[face]
        else:
            corners, normals, uvs = surface_corners[face], surface_normals[face], surface_uv[face]
        bu, bv = barycentric[index, 0], barycentric[index, 1]
        bw = 1.0 - bu - bv
        t = depths[index]
        e1, e2, direction, point, normal = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        for k in range(3):
            e1[k], e2[k] = corners[1, k] - corners[0, k], corners[2, k] - corners[0, k]
            direction[k] = rays[index, 3 + k]
            point[k] = rays[index, k] + t * direction[k]
            normal[k] = bw * normals[0, k] + bu * normals[1, k] + bv * normals[2, k]
        g = np.array([e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2], e1[0] * e2[1] - e1[1] * e2[0]])
        # The footprint on the face's plane (Igehy 1999), then in texture space by the face's own linear map.
        along = direction[0] * g[0] + direction[1] * g[1] + direction[2] * g[2]
        if abs(along) < 1e-9:
            along = 1e-9
        shift_x = (step_x[0] * g[0] + step_x[1] * g[1] + step_x[2] * g[2]) / along
        shift_y = (step_y[0] * g[0] + step_y[1] * g[1] + step_y[2] * g[2]) / along
        d11 = e1[0] * e1[0] + e1[1] * e1[1] + e1[2] * e1[2]
        d12 = e1[0] * e2[0] + e1[1] * e2[1] + e1[2] * e2[2]
        d22 = e2[0] * e2[0] + e2[1] * e2[1] + e2[2] * e2[2]
        determinant = max(d11 * d22 - d12 * d12, 1e-20)
        x1, x2, y1, y2 = 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            moved_x = t * footprint * (step_x[k] - direction[k] * shift_x)
            moved_y = t * footprint * (step_y[k] - direction[k] * shift_y)
            x1, x2 = x1 + moved_x * e1[k], x2 + moved_x * e2[k]
            y1, y2 = y1 + moved_y * e1[k], y2 + moved_y * e2[k]
        xu, xv = (d22 * x1 - d12 * x2) / determinant, (d11 * x2 - d12 * x1) / determinant
        yu, yv = (d22 * y1 - d12 * y2) / determinant, (d11 * y2 - d12 * y1) / determinant
        u1, u2 = uvs[1, 0] - uvs[0, 0], uvs[2, 0] - uvs[0, 0]
        v1, v2 = uvs[1, 1] - uvs[0, 1], uvs[2, 1] - uvs[0, 1]
        u, v = uvs[0, 0] + bu * u1 + bv * u2, uvs[0, 1] + bu * v1 + bv * v2
        ux, vx, uy, vy = xu * u1 + xv * u2, xu * v1 + xv * v2, yu * u1 + yv * u2, yu * v1 + yv * v2
        light = np.empty(7)
        if part == 0:
            red, green, blue = sample(object_texels, object_levels, object_wrap, linear_of_byte, u, v, ux, vx, uy, vy)
            steps = light_steps[face]
            i, j = min(int(bu * steps), steps - 1), min(int(bv * steps), steps - 1)
            if i + j > steps - 1:
                j = steps - 1 - i
            fi, fj = bu * steps - i, bv * steps - j
            base = light_first[face] + i * (steps + 1) - i * (i - 1) // 2 + j
            right = light_first[face] + (i + 1) * (steps + 1) - (i + 1) * i // 2 + j
            upper = fi + fj > 1.0 and i + j < steps - 1
            for k in range(7):
                if upper:
                    light[k] = (
                        (fi + fj - 1.0) * object_light[right + 1, k]
                        + (1.0 - fj) * object_light[right, k] + (1.0 - fi) * object_light[base + 1, k]
                    )  # fmt: skip
                else:
                    light[k] = (1.0 - fi - fj) * object_light[base, k] + fi * object_light[right, k] + fj * object_light[base + 1, k]
        else:
            red, green, blue = sample(surface_texels, surface_levels, False, linear_of_byte, u, v, ux, vx, uy, vy)
            cells = surface_light.shape[0]
            x = min(max((point[0] - surface_origin[0]) / surface_side * cells - 0.5, 0.0), cells - 1.001)
            y = min(max((point[1] - surface_origin[1]) / surface_side * cells - 0.5, 0.0), cells - 1.001)
            i, j = int(x), int(y)
            fx, fy = x - i, y - j
            for k in range(7):
                light[k] = (1 - fy) * ((1 - fx) * surface_light[j, i, k] + fx * surface_light[j, i + 1, k]) + fy * (
                    (1 - fx) * surface_light[j + 1, i, k] + fx * surface_light[j + 1, i + 1, k]
                )
        diffuse, shine = light[0], 0.0
        size = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        length = math.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
        cosine = 0.0
        for k in range(3):
            normal[k] /= size
            direction[k] /= length
            cosine -= normal[k] * direction[k]
        if part == 1:
            diffuse *= 1.0 - 2.0 * (1.0 - normal[2])
        elif cosine > 0.0:
            for k in range(3):
                direction[k] += 2.0 * cosine * normal[k]
            reflectance = NORMAL_REFLECTANCE + (0.3 - NORMAL_REFLECTANCE) * (1.0 - cosine) ** 5
            seen = _highlight(point, direction, centres, axes, half_side, radiances, light[1:]) + sky * min(light[0], 1.0)
            shine = reflectance * seen
        out[index, 0] = red * diffuse + shine
        out[index, 1] = green * diffuse + shine
        out[index, 2] = blue * diffuse + shine
    return out
