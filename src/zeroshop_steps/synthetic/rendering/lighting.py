"""Light of the virtual scenes: six large area lights, one an axis direction, and a faint sky; baked once a scene.

All light that does not depend on the view, soft shadows and one bounce off the surface included, is computed at samples on
the object (a lattice in each triangle) and on the surface (a grid), then interpolated while rendering: free of noise, and the
same in all views. Every sample keeps its diffuse irradiance and how much of each light it sees, for the highlights.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numba
import numpy as np

from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds
from zeroshop_steps.synthetic.scenes.scene_meshes import SceneMesh

LIGHT_DISTANCE_IN_SIZES, LIGHT_HALF_SIDE_IN_SIZES = 8.0, 3.0  # in the largest side of the object
LIGHT_STRENGTHS = (0.60, 0.40, 0.50, 0.35, 1.00, 0.40)  # towards +x, -x, +y, -y, +z, -z
SKY = 0.25  # radiance from all around, beside strengths like LIGHT_STRENGTHS
SAMPLES_A_SIDE, SKY_SAMPLES = 4, 32  # shadow rays to each light, squared, and to the sky
CHANNELS = len(LIGHT_STRENGTHS) + 1  # diffuse light, and how much of each of the six lights is seen
SURFACE_CELLS = 320  # a side of the baked part of the ground
SURFACE_BAKED_IN_SIZES = 2.6  # half its side, in the largest side of the object; farther out, the light at its border is taken
WHITE_LEVEL = 0.9
SURFACE_BOUNCE, OWN_BOUNCE = 0.22, 0.12  # light that comes back from the ground, and from the object itself, where these hide the sky
OBJECT_CELLS = 30  # baked points along the largest side of the object
BAKE_CHUNK = 8192  # points at a time


@dataclass(frozen=True)
class Lights:
    """Six square area lights that face the object.

    Attributes:
        centres: (6, 3) mm.
        axes: (6, 3, 3) two in-plane unit vectors and the direction towards the object.
        half_side_mm: half of each square's side.
        radiances: (6,) exposure included: a white surface that faces up, unshadowed, shows `WHITE_LEVEL`.
        sky: radiance of the sky, exposure included.
    """

    centres: np.ndarray
    axes: np.ndarray
    half_side_mm: float
    radiances: np.ndarray
    sky: float


@dataclass(frozen=True)
class BakedLight:
    """Light at the samples.

    Attributes:
        object_first: (F,) index of each face's first lattice sample.
        object_steps: (F,) number of lattice steps along each face's edges.
        object_light: (S, 7) irradiance / pi and the visible share of the six lights.
        surface_light: (N, N, 7) the same on the surface's grid, row by y.
        surface_origin_mm, surface_side_mm: lower corner (2,) and side of that grid.
    """

    object_first: np.ndarray
    object_steps: np.ndarray
    object_light: np.ndarray
    surface_light: np.ndarray
    surface_origin_mm: np.ndarray
    surface_side_mm: float


def place_lights(bounds: ObjectBounds, on_surface: bool, strengths: Sequence[float] = LIGHT_STRENGTHS) -> Lights:
    """Lights around the object, their strength chosen for the exposure. On a surface the four at the sides stand on it.

    Args:
        strengths: six, relative to each other, in the order of `LIGHT_STRENGTHS`.
    """
    directions = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    angle = np.radians(bounds.front_azimuth_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    directions = directions @ turn.T
    axes = np.stack([np.roll(directions, 2, 0), np.cross(directions, np.roll(directions, 2, 0)), -directions], 1)
    half_side_mm = LIGHT_HALF_SIDE_IN_SIZES * bounds.largest_mm
    centres = bounds.centre_mm + directions * LIGHT_DISTANCE_IN_SIZES * bounds.largest_mm
    if on_surface:
        centres[:4, 2] = bounds.bottom_mm + half_side_mm
    lights = Lights(centres, axes, half_side_mm, np.array(strengths), SKY)
    up = np.array([[0.0, 0.0, 1.0]], np.float32)
    rays, weights = _light_rays(bounds.centre_mm[None].astype(np.float32), up, centres, axes, half_side_mm, 16, 0)
    exposure = WHITE_LEVEL / ((weights.sum(2)[0] * lights.radiances).sum() / np.pi + SKY)
    return Lights(centres, axes, half_side_mm, lights.radiances * exposure, SKY * exposure)


def bake_light(
    scene: o3d.t.geometry.RaycastingScene,
    parts: list[SceneMesh],
    bounds: ObjectBounds,
    lights: Lights,
    seed: int,
    merged_mm: float | None = None,
    surface_cells: int | None = None,
) -> BakedLight:
    """Compute the light at all samples. `parts[0]` is the object (geometry 0), `parts[1]`, if any, the surface.

    Samples of the object that lie within about `merged_mm` of each other and face the same way share theirs, where it is given.
    The surface's samples are the middles of `surface_cells` squared cells, of SURFACE_CELLS by default.
    """
    part = parts[0]
    corners = part.vertices[part.faces]
    longest_mm = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2).max(1)
    steps = np.clip(np.ceil(longest_mm * OBJECT_CELLS / bounds.largest_mm), 1, 64).astype(np.int64)
    first = np.concatenate([[0], np.cumsum((steps + 1) * (steps + 2) // 2)])
    points, normals = _lattice(corners, part.corner_normals, first, steps, 2e-4 * bounds.largest_mm)
    bounce = SURFACE_BOUNCE if len(parts) > 1 else 0.0
    chosen, share = _merge_samples(points, normals, merged_mm) if merged_mm else (slice(None), slice(None))
    object_light = _bake_points(scene, points[chosen], normals[chosen], lights, bounce, seed)[share]
    cells = (surface_cells or SURFACE_CELLS) if len(parts) > 1 else 2
    side_mm = 2 * SURFACE_BAKED_IN_SIZES * bounds.largest_mm
    origin_mm = bounds.centre_mm[:2] - side_mm / 2
    surface_light: np.ndarray = np.ones((cells, cells, CHANNELS), np.float32)
    if len(parts) > 1:
        place = (np.arange(cells) + 0.5) / cells * side_mm
        x, y = np.meshgrid(place + origin_mm[0], place + origin_mm[1])
        points = np.stack([x, y, np.full_like(x, bounds.bottom_mm + 1e-3 * bounds.largest_mm)], -1).reshape(-1, 3).astype(np.float32)
        normals = np.zeros_like(points)
        normals[:, 2] = 1
        surface_light = _bake_points(scene, points, normals, lights, 0.0, seed + 1).reshape(cells, cells, CHANNELS)
        surface_light = cv2.GaussianBlur(surface_light, (0, 0), 1.2, borderType=cv2.BORDER_REPLICATE)
    return BakedLight(first[:-1], steps, object_light, surface_light, origin_mm, side_mm)


def _merge_samples(points: np.ndarray, normals: np.ndarray, merged_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """(M,) samples that stand for all, and (S,) which of them stands for each."""
    cells = np.concatenate([np.rint(points / merged_mm), np.rint(4.0 * normals)], 1).astype(np.int16)
    keys = np.ascontiguousarray(cells).view(np.dtype((np.void, cells.shape[1] * cells.itemsize))).ravel()
    _, chosen, share = np.unique(keys, return_index=True, return_inverse=True)
    return chosen, share.ravel()


def _bake_points(
    scene: o3d.t.geometry.RaycastingScene, points: np.ndarray, normals: np.ndarray, lights: Lights, bounce: float, seed: int
) -> np.ndarray:
    """(S, 7) light at (S, 3) points with (S, 3) normals."""
    out = np.empty((len(points), CHANNELS), np.float32)
    for start in range(0, len(points), BAKE_CHUNK):
        p, n = points[start : start + BAKE_CHUNK], normals[start : start + BAKE_CHUNK]
        rays, weights = _light_rays(p, n, lights.centres, lights.axes, lights.half_side_mm, SAMPLES_A_SIDE, seed + start)
        useful = np.flatnonzero(weights.reshape(-1) > 0)
        blocked = scene.test_occlusions(o3d.core.Tensor(rays.reshape(-1, 6)[useful]), 0.0, 0.999).numpy()
        seen = np.zeros(weights.size, np.float32)
        seen[useful] = ~blocked
        direct = (weights * seen.reshape(weights.shape)).sum(2)
        possible = weights.sum(2)
        sky_rays = _sky_rays(p, n, SKY_SAMPLES, seed + start)
        hit = scene.cast_rays(o3d.core.Tensor(sky_rays.reshape(-1, 6)))["geometry_ids"].numpy().reshape(len(p), SKY_SAMPLES)
        own_share = (hit == 0).mean(1)
        below_share = (1.0 - own_share) * (1.0 - n[:, 2]) / 2 if bounce > 0 else 0.0
        diffuse = (direct * lights.radiances).sum(1) / np.pi + lights.sky * (1.0 - own_share - below_share)
        out[start : start + len(p), 0] = diffuse + bounce * below_share + OWN_BOUNCE * own_share
        out[start : start + len(p), 1:] = direct / np.maximum(possible, 1e-9)
    return out


@numba.njit(cache=True, inline="always")
def _random(index, salt):
    """A number in 0..1 from two integers (the PCG output hash, Jarzynski and Olano 2020)."""
    state = np.uint32(
        (np.uint64(index) * np.uint64(747796405) + np.uint64(salt) * np.uint64(2891336453) + np.uint64(12345)) & np.uint64(0xFFFFFFFF)
    )
    word = np.uint32(np.uint64((state >> ((state >> np.uint32(28)) + np.uint32(4))) ^ state) * np.uint64(277803737) & np.uint64(0xFFFFFFFF))
    word = np.uint32((word >> np.uint32(22)) ^ word)
    return np.float64(word) / 4294967296.0


@numba.njit(cache=True, parallel=True)
def _light_rays(points, normals, centres, axes, half_side, a_side, seed):
    """Stratified rays from every point to every light: (S, 6, n, 6) and their weights cos cos / d^2 dA, (S, 6, n).

    The weights are those of the cells' middles, so that only what is partly in shadow carries the noise of the jitter.
    """
    count, samples = points.shape[0], a_side * a_side
    rays = np.zeros((count, 6, samples, 6), np.float32)
    weights = np.zeros((count, 6, samples), np.float32)
    area = (2.0 * half_side) ** 2 / samples
    for index in numba.prange(count):
        for light in range(6):
            for cell in range(samples):
                number = (index * 6 + light) * samples + cell
                a = ((cell % a_side + 0.5) / a_side * 2.0 - 1.0) * half_side
                b = ((cell // a_side + 0.5) / a_side * 2.0 - 1.0) * half_side
                shift_a = (_random(number, 2 * seed) - 0.5) / a_side * 2.0 * half_side
                shift_b = (_random(number, 2 * seed + 1) - 0.5) / a_side * 2.0 * half_side
                squared, facing, leaving = 0.0, 0.0, 0.0
                for k in range(3):
                    d = centres[light, k] + a * axes[light, 0, k] + b * axes[light, 1, k] - points[index, k]
                    rays[index, light, cell, k] = points[index, k]
                    rays[index, light, cell, 3 + k] = d + shift_a * axes[light, 0, k] + shift_b * axes[light, 1, k]
                    squared += d * d
                    facing += d * normals[index, k]
                    leaving -= d * axes[light, 2, k]
                if facing > 0.0 and leaving > 0.0:
                    weights[index, light, cell] = facing * leaving / (squared * squared) * area
    return rays, weights


@numba.njit(cache=True, parallel=True)
def _sky_rays(points, normals, samples, seed):
    """Cosine-distributed rays (S, n, 6) around the normals (Malley's method on a jittered spiral)."""
    rays = np.zeros((points.shape[0], samples, 6), np.float32)
    for index in numba.prange(points.shape[0]):
        n = normals[index]
        tangent = np.zeros(3)
        tangent[0 if abs(n[0]) < 0.6 else 1] = 1.0
        t = np.array([tangent[1] * n[2] - tangent[2] * n[1], tangent[2] * n[0] - tangent[0] * n[2], tangent[0] * n[1] - tangent[1] * n[0]])
        t /= np.sqrt((t * t).sum())
        b = np.array([n[1] * t[2] - n[2] * t[1], n[2] * t[0] - n[0] * t[2], n[0] * t[1] - n[1] * t[0]])
        turn = _random(index, seed + 7) * 2.0 * np.pi
        for k in range(samples):
            share = (k + 0.5) / samples
            radius, angle = np.sqrt(share), k * 2.399963229728653 + turn
            x, y, z = radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - share)
            for axis in range(3):
                rays[index, k, axis] = points[index, axis]
                rays[index, k, 3 + axis] = x * t[axis] + y * b[axis] + z * n[axis]
    return rays


@numba.njit(cache=True, parallel=True)
def _lattice(corners, corner_normals, first, steps, lift):
    """Sample points, lifted off the faces by `lift`, and unit normals on a triangular lattice of each face."""
    points = np.empty((first[-1], 3), np.float32)
    normals = np.empty((first[-1], 3), np.float32)
    for face in numba.prange(corners.shape[0]):
        c = corners[face]
        ax, ay, az = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
        bx, by, bz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
        gx, gy, gz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        length = max(np.sqrt(gx * gx + gy * gy + gz * gz), 1e-20)
        gx, gy, gz = gx / length, gy / length, gz / length
        index = first[face]
        for i in range(steps[face] + 1):
            for j in range(steps[face] + 1 - i):
                u = 0.96 * i / steps[face] + 0.04 / 3
                v = 0.96 * j / steps[face] + 0.04 / 3
                w = 1.0 - u - v
                nx = w * corner_normals[face, 0, 0] + u * corner_normals[face, 1, 0] + v * corner_normals[face, 2, 0]
                ny = w * corner_normals[face, 0, 1] + u * corner_normals[face, 1, 1] + v * corner_normals[face, 2, 1]
                nz = w * corner_normals[face, 0, 2] + u * corner_normals[face, 1, 2] + v * corner_normals[face, 2, 2]
                scale = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-12)
                normals[index, 0], normals[index, 1], normals[index, 2] = nx / scale, ny / scale, nz / scale
                out = lift if gx * nx + gy * ny + gz * nz >= 0.0 else -lift
                points[index, 0] = w * c[0, 0] + u * c[1, 0] + v * c[2, 0] + out * gx
                points[index, 1] = w * c[0, 1] + u * c[1, 1] + v * c[2, 1] + out * gy
                points[index, 2] = w * c[0, 2] + u * c[1, 2] + v * c[2, 2] + out * gz
                index += 1
    return points, normals
