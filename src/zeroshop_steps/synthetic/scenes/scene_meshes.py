"""The geometry and the looks of the virtual scenes: su_l (plain surface), su_h (richly textured surface), se (object on black)."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.meshes.surface_parts import with_texture
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.synthetic.rendering.textures import MipPyramid, build_pyramid, find_texture_coverage
from zeroshop_steps.synthetic.scenes.camera_rings import ObjectBounds

SCENES = ("su_l", "su_h", "se")
SURFACE_SIDE_IN_SIZES = 10.0  # in the largest side of the object
SURFACE_TEXELS = 4096  # a side of the rich texture; the plain one has half
PLAIN_GREY, PLAIN_CHANGE = 150.0, 7.0  # of 255, and from its darkest to its brightest texel
RICH_SHAPES = ((0.05, 130), (0.025, 500), (0.012, 2000), (0.006, 7000), (0.003, 20000))
"""Of the rich texture: size as a share of its side, and how many. At half the size there are about four times as many, so that each
size covers about as much, and a camera finds corners from near and far."""
FIXED_POINT = 16  # OpenCV takes coordinates in sixteenths of a pixel, by `shift` 4


@dataclass(frozen=True)
class SceneMesh:
    """One textured surface of a scene, in the form the shading kernel reads.

    Attributes:
        vertices: (V, 3) float32 mm.
        faces: (F, 3) uint32.
        corner_normals: (F, 3, 3) float32 unit normals at each face's corners.
        corner_uv: (F, 3, 2) float32 texture coordinates, origin at the lower left.
        pyramid: its texture.
    """

    vertices: np.ndarray
    faces: np.ndarray
    corner_normals: np.ndarray
    corner_uv: np.ndarray
    pyramid: MipPyramid


def make_object_mesh(mesh: Mesh) -> SceneMesh:
    """The object itself. Normals are those of the mesh, else smooth ones; without a texture, it has the colours of its vertices."""
    mesh = with_texture(mesh)
    uv, texture, normals = mesh.texture_coordinates, mesh.texture_image, mesh.vertex_normals
    inside = bool((uv > -1e-3).all() and (uv < 1 + 1e-3).all())
    height, width = texture.shape[:2]
    coverage = find_texture_coverage(uv, mesh.faces, width, height) if inside else None
    return SceneMesh(
        mesh.vertices.astype(np.float32),
        mesh.faces.astype(np.uint32),
        normals[mesh.faces].astype(np.float32),
        uv[mesh.faces].astype(np.float32),
        build_pyramid(texture, coverage, wrap=not inside),
    )


def make_surface_mesh(
    scene: str,
    bounds: ObjectBounds,
    seed: int,
    paint: Callable[[np.ndarray], None] | None = None,
    make_texture: Callable[[np.random.Generator], np.ndarray] | None = None,
) -> SceneMesh | None:
    """The square support surface under the object; None for se.

    su_h is flat, so that its texture alone makes it rich. su_l undulates downwards by at most 0.3 % of the object's size.
    `make_texture` makes its (texels, texels, 3) uint8 texture, by default the scene's own; `paint` changes it in place: what lies on it.
    """
    if scene == "se":
        return None
    rng = np.random.default_rng([seed, SCENES.index(scene)])
    cells = 96 if scene == "su_l" else 1
    half_mm = SURFACE_SIDE_IN_SIZES * bounds.largest_mm / 2
    grid = np.linspace(-1.0, 1.0, cells + 1)
    x, y = np.meshgrid(grid * half_mm + bounds.centre_mm[0], grid * half_mm + bounds.centre_mm[1])
    depth_mm = np.zeros_like(x)
    if scene == "su_l":
        depth_mm = make_noise(rng, cells + 1, 8, 32) * 0.003 * bounds.largest_mm
    vertices = np.stack([x, y, bounds.bottom_mm - depth_mm], -1).reshape(-1, 3)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    right, up, both = corner + 1, corner + cells + 1, corner + cells + 2
    faces = np.concatenate([np.stack([corner, right, both], 1), np.stack([corner, both, up], 1)])
    uv = np.stack(np.meshgrid((grid + 1) / 2, (grid + 1) / 2), -1).reshape(-1, 2)
    normals = Mesh(vertices, faces).vertex_normals
    texture = (make_texture or (make_plain_texture if scene == "su_l" else make_rich_texture))(rng)
    if paint:
        paint(texture)
    return SceneMesh(
        vertices.astype(np.float32),
        faces.astype(np.uint32),
        normals[faces].astype(np.float32),
        uv[faces].astype(np.float32),
        build_pyramid(texture),
    )


def make_plain_texture(rng: np.random.Generator, texels: int = SURFACE_TEXELS // 2) -> np.ndarray:
    """(texels, texels, 3) uint8: a near-uniform grey, its brightness off by at most about two per cent."""
    grey = PLAIN_GREY + PLAIN_CHANGE * (make_noise(rng, texels, 8, texels // 2) - 0.5)
    return np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, -1)


def make_rich_texture(rng: np.random.Generator, texels: int = SURFACE_TEXELS) -> np.ndarray:
    """(texels, texels, 3) uint8: noise of all scales under thousands of random shapes of all sizes, nothing repeats."""
    grey = np.clip((make_noise(rng, texels, 16, texels // 2, 0.85) - 0.5) * 500 + 115, 12, 243)
    tint = np.stack([make_noise(rng, texels // 8, 8, 64) for _ in range(3)], -1) * 0.8 + 0.6
    image = np.rint(np.clip(cv2.resize(tint, (texels, texels)) * grey[..., None], 0, 250)).astype(np.uint8)
    for size, count in RICH_SHAPES:
        for _ in range(count):
            _draw_shape(image, rng, size * texels * rng.uniform(0.5, 1.5))
    return image


def _draw_shape(image: np.ndarray, rng: np.random.Generator, size: float) -> None:
    # Number by number: for so few, arrays take longer.
    x, y = (int(along * FIXED_POINT) for along in rng.uniform(0.0, image.shape[0], 2).tolist())
    light = rng.uniform(15, 240)
    color = [int(min(max(light * tint, 5.0), 250.0)) for tint in rng.uniform(0.65, 1.25, 3).tolist()]
    radius, kind, angle = max(int(size * FIXED_POINT / 2), FIXED_POINT), rng.integers(4), float(rng.uniform(0, 360))
    if kind == 0:
        cv2.ellipse(image, (x, y), (radius, int(radius * rng.uniform(0.3, 1.0))), angle, 0, 360, color, -1, cv2.LINE_AA, 4)
    elif kind == 1:
        cv2.circle(image, (x, y), radius, color, max(int(size * 0.15), 1), cv2.LINE_AA, 4)
    else:
        corners = 3 + int(rng.integers(4))
        around = np.sort(rng.uniform(0, 2 * np.pi, corners))
        radii = radius * rng.uniform(0.5, 1.2, corners)
        points = np.stack([x + radii * np.cos(around), y + radii * np.sin(around)], 1).astype(np.int32)
        cv2.fillPoly(image, [points], color, cv2.LINE_AA, 4)


def make_noise(rng: np.random.Generator, texels: int, coarsest: int, finest: int, falling: float = 0.7) -> np.ndarray:
    """(texels, texels) float32 noise in 0..1: random grids of `coarsest`, twice, ... `finest` cells, amplitude `falling` each time."""
    total: np.ndarray = np.zeros((coarsest, coarsest), np.float32)
    amplitude, cells, sum_amplitude = 1.0, coarsest, 0.0
    while cells <= finest:
        total = np.asarray(cv2.resize(total, (cells, cells), interpolation=cv2.INTER_CUBIC), np.float32)
        total += amplitude * rng.random((cells, cells), dtype=np.float32)
        sum_amplitude += amplitude
        amplitude, cells = amplitude * falling, cells * 2
    return np.clip(cv2.resize(total, (texels, texels), interpolation=cv2.INTER_CUBIC) / sum_amplitude, 0.0, 1.0)
