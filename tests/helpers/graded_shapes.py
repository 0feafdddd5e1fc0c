"""Shapes for judging the grade: most are plain, some hollow, some rough by nature, one is in two parts.

The grade was set on printed demo objects, on which a plain surface is usually a wrong one. As a command, writes them as
a dataset in BOP's layout:

    python tests/helpers/graded_shapes.py FOLDER
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply

TEXTURE_PX = 512
Shape = tuple[trimesh.Trimesh, tuple[int, int, int], float]  # in mm, z up; sRGB colour; how strongly the colour varies, of 1


def _turned(profile: list[tuple[float, float]]) -> trimesh.Trimesh:
    """The closed solid that a (radius, height) profile sweeps around z."""
    return trimesh.creation.revolve(np.array(profile, float), sections=96)


def _joined(*solids: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.boolean.union(list(solids), engine="manifold")


def _box(size: tuple[float, float, float], at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))


def apple() -> Shape:
    """A ball with a dimple at either end."""
    angle = np.linspace(0.0, np.pi, 40)
    dent = 1.0 - 0.35 * np.exp(-((angle / 0.35) ** 2)) - 0.2 * np.exp(-(((np.pi - angle) / 0.4) ** 2))
    profile = np.c_[np.sin(angle) * 38.0, -np.cos(angle[::-1] * 0 + np.pi - angle) * 36.0 * dent][::-1]
    profile[[0, -1], 0] = 0.0
    return _turned([tuple(point) for point in profile]), (150, 40, 35), 0.25


def cube() -> Shape:
    """A plain cube."""
    return _box((60.0, 60.0, 60.0)), (70, 100, 150), 0.05


def bottle() -> Shape:
    """A plain bottle, without a label."""
    profile = [(0, 0), (32, 0), (35, 4), (35, 110), (30, 130), (14, 150), (13, 185), (15, 186), (15, 200), (0, 200)]
    return _turned(profile), (60, 110, 70), 0.1


def toy_brick() -> Shape:
    """A plain brick with eight studs."""
    studs = [trimesh.creation.cylinder(7.5, 7.0) for _ in range(8)]
    for k, stud in enumerate(studs):
        stud.apply_translation((-36.0 + 24.0 * (k % 4), -12.0 + 24.0 * (k // 4), 22.0))
    return _joined(_box((96.0, 48.0, 38.0)), *studs), (180, 45, 40), 0.05


def plate() -> Shape:
    """A plain white plate."""
    profile = [(0, 0), (55, 0), (60, 3), (105, 18), (107, 20), (105, 22), (58, 8), (0, 6)]
    return _turned(profile), (225, 222, 215), 0.03


def vase() -> Shape:
    """Printed outside, dark and plain inside."""
    profile = [(0, 0), (40, 0), (48, 60), (36, 140), (42, 180), (38, 180), (32, 140), (44, 60), (36, 6), (0, 6)]
    return _turned(profile), (150, 120, 90), 0.9


def two_parts() -> Shape:
    """Two printed boxes that do not touch."""
    return (
        trimesh.util.concatenate([_box((50.0, 40.0, 70.0), (-35.0, 0.0, 0.0)), _box((40.0, 50.0, 60.0), (30.0, 0.0, -5.0))]),
        (140, 130, 110),
        0.9,
    )


def ring() -> Shape:
    """A plain torus that lies on the ground."""
    return trimesh.creation.torus(50.0, 16.0, major_sections=96, minor_sections=48), (200, 160, 50), 0.1


def bracket() -> Shape:
    """A plain angle with a hole in its wall."""
    hole = trimesh.creation.cylinder(14.0, 40.0, transform=trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    hole.apply_translation((0.0, 30.0, 55.0))
    solid = _joined(_box((80.0, 70.0, 10.0)), _box((80.0, 10.0, 90.0), (0.0, 30.0, 40.0)))
    return trimesh.boolean.difference([solid, hole], engine="manifold"), (130, 130, 135), 0.1


def stone() -> Shape:
    """Rough by nature, with a texture."""
    ball = trimesh.creation.icosphere(subdivisions=6, radius=1.0)
    rng = np.random.default_rng(0)
    height = np.ones(len(ball.vertices))
    for frequency, strength in ((3.0, 0.08), (8.0, 0.03), (20.0, 0.008)):
        waves = rng.normal(size=(12, 3)) * frequency
        height += strength * np.sin(ball.vertices @ waves.T + rng.uniform(0, 2 * np.pi, 12)).mean(1) * 2.0
    return trimesh.Trimesh(ball.vertices * height[:, None] * (45.0, 38.0, 32.0), ball.faces), (135, 125, 115), 0.7


def gear() -> Shape:
    """A plain wheel with teeth."""
    teeth = [_box((104.0, 7.0, 24.0)) for _ in range(10)]
    for k, tooth in enumerate(teeth):
        tooth.apply_transform(trimesh.transformations.rotation_matrix(np.pi * k / 10, (0, 0, 1)))
    wheel = [trimesh.creation.cylinder(44.0, 24.0, sections=96), trimesh.creation.cylinder(15.0, 60.0)]
    return _joined(*wheel, *teeth), (95, 95, 105), 0.1


def cup() -> Shape:
    """Plain and light, in and outside; its inside cannot be told from a lid."""
    profile = [(0, 0), (30, 0), (40, 90), (37, 90), (28, 5), (0, 5)]
    return _turned(profile), (215, 205, 185), 0.05


SHAPES: tuple[Callable[[], Shape], ...] = (apple, cube, bottle, toy_brick, plate, vase, two_parts, ring, bracket, stone, gear, cup)


def make_shape(shape: Callable[[], Shape]) -> Mesh:
    """The shape with a texture: three projections, each with speckles of its own, stand on the ground around the z axis."""
    solid, color, variation = shape()
    if solid.volume < 0:
        solid.invert()
    solid = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(solid.vertices, solid.faces, 8.0, max_iter=20))
    low, high = solid.bounds
    solid.apply_translation((-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))
    axis = np.abs(solid.face_normals).argmax(1)
    corners = solid.vertices[solid.faces]
    scaled = (corners - solid.bounds[0]) / np.ptp(solid.bounds, axis=0).max() * 0.96 + 0.02
    planes = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    uv = np.take_along_axis(scaled, np.repeat(planes[:, None], 3, 1), 2)
    uv[..., 0] = (uv[..., 0] + axis[:, None]) / 3.0
    texture = _make_texture(color, variation, inside_is_dark=shape is vase)
    if shape is vase:  # its inner wall faces the axis
        middle = corners.mean(1)
        inner = (np.einsum("ij,ij->i", solid.face_normals[:, :2], middle[:, :2]) < 0) | (
            (axis == 2) & (middle[:, 2] < 20) & (middle[:, 2] > 1)
        )
        uv[inner] = (12 / TEXTURE_PX, 1.0 - 12 / TEXTURE_PX)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), faces, uv=uv.reshape(-1, 2), texture=texture)


def _make_texture(color: tuple[int, int, int], variation: float, inside_is_dark: bool) -> np.ndarray:
    """(TEXTURE_PX, TEXTURE_PX, 3) uint8: the colour with speckles of two sizes; one dark corner for an inside."""
    rng = np.random.default_rng(0)
    speckles = np.zeros((TEXTURE_PX, TEXTURE_PX), np.float32)
    for size in (3, 12):
        noise = rng.normal(size=(TEXTURE_PX // size + 1,) * 2).astype(np.float32)
        speckles += cv2.resize(noise, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_CUBIC)
    image = np.array(color) * (1.0 + 0.35 * variation * speckles[..., None])
    if inside_is_dark:
        image[:24, :24] = (38, 32, 28)
    return np.clip(image, 8, 247).astype(np.uint8)


def _measure_diameter(mesh: Mesh) -> float:
    """The largest distance between two points."""
    hull = mesh.vertices[ConvexHull(mesh.vertices).vertices]
    return float(pdist(hull).max())


def write_shapes(folder: Path) -> None:
    """Write obj_NUMBER.ply of all shapes, and models_info.json."""
    folder.mkdir(parents=True, exist_ok=True)
    info = {}
    for number, shape in enumerate(SHAPES, start=1):
        mesh = make_shape(shape)
        name = f"obj_{number:06d}"
        assert mesh.texture is not None
        write_image(folder / f"{name}.png", mesh.texture)
        write_ply(folder / f"{name}.ply", mesh, f"{name}.png")
        low, size = mesh.vertices.min(0), np.ptp(mesh.vertices, axis=0)
        info[str(number)] = {"diameter": _measure_diameter(mesh)} | {
            key: float(value) for key, value in zip(("min_x", "min_y", "min_z", "size_x", "size_y", "size_z"), (*low, *size), strict=True)
        }
        print(name, shape.__name__, size.round(1), len(mesh.faces), file=sys.stderr)
    (folder / "models_info.json").write_text(json.dumps(info, indent=2))


if __name__ == "__main__":
    write_shapes(Path(sys.argv[1]))
