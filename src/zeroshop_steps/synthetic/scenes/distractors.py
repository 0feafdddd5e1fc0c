"""Things that nobody asks for: boxes, cylinders and balls of random size and print, which hide and distract."""

import cv2
import numpy as np
import trimesh

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

TEXTURE_PX = 256
BORDER = 0.02  # share of the texture that is left free at each side, so that filters mix nothing in


def make_distractor(rng: np.random.Generator) -> Mesh:
    """A textured solid of 30 to 160 mm, its middle at the origin."""
    kind = rng.integers(3)
    if kind == 0:
        solid = trimesh.creation.box(rng.uniform([40, 40, 30], [120, 90, 150]))
    elif kind == 1:
        solid = trimesh.creation.cylinder(rng.uniform(15, 45), rng.uniform(40, 150), sections=64)
    else:
        solid = trimesh.creation.icosphere(3, rng.uniform(20, 45))
    return map_as_boxes(solid, _draw_texture(rng))


def map_as_boxes(solid: trimesh.Trimesh, texture: np.ndarray) -> Mesh:
    """A flat-shaded mesh of a solid on which each side of its bounding box projects the whole (H, W, 3) uint8 texture."""
    corners, normals = np.asarray(solid.triangles), np.asarray(solid.face_normals)
    shares = (corners - solid.bounds[0]) / (solid.bounds[1] - solid.bounds[0]) * (1 - 2 * BORDER) + BORDER
    flat = np.abs(normals).argmax(1)
    axes = np.array([[1, 2], [0, 2], [0, 1]])[flat]
    uv = np.take_along_axis(shares, np.repeat(axes[:, None], 3, 1), 2)
    faces = np.arange(corners.size // 3).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), faces, np.repeat(normals, 3, 0), uv.reshape(-1, 2), texture)


def _draw_texture(rng: np.random.Generator) -> np.ndarray:
    """(TEXTURE_PX, TEXTURE_PX, 3) uint8: patches, stripes and letters on a plain colour."""
    image = np.tile(rng.integers(30, 230, 3).astype(np.uint8), (TEXTURE_PX, TEXTURE_PX, 1))
    for _ in range(int(rng.integers(4, 20))):
        color = rng.integers(10, 245, 3).tolist()
        corner, size = rng.integers(0, TEXTURE_PX, 2), rng.integers(8, 90, 2)
        cv2.rectangle(image, corner.tolist(), (corner + size).tolist(), color, -1)
    for _ in range(int(rng.integers(0, 5))):
        letters = "".join(chr(int(letter)) for letter in rng.integers(65, 91, 5))
        place = rng.integers(0, TEXTURE_PX, 2).tolist()
        cv2.putText(image, letters, place, cv2.FONT_HERSHEY_SIMPLEX, float(rng.uniform(0.6, 1.8)), rng.integers(0, 255, 3).tolist(), 3)
    return image
