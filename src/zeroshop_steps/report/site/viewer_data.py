"""Meshes, cameras and points as JavaScript files, since a page that is opened from disk may load scripts but may not fetch data.

Numbers are quantised and written in base64: positions with 16 bits over the bounding box (3 micrometres for an object of 200 mm),
normals and distances with 8 bits.
"""

import base64
import json
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import SparseModel
from zeroshop_steps.geometry.cameras.transforms import transform_camera, transform_points
from zeroshop_steps.report.site.mesh_reduction import ReducedMesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write

VIEW_PX = 300  # side of a picture or a plot
QUALITY = 82  # 0 to 100, of WebP
UNSEEN = 255
"""The value of a distance that does not count, such as on the unseen underside."""
LARGEST = UNSEEN - 1  # the value of the largest distance that is shown
POINTS = 6000  # of the sparse model at most, those that most photos see; more would only make the page larger


def write_data(path: Path, content: dict) -> None:
    """Write a script that passes `content` to the page, which identifies it by its address."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    with atomic_write(path) as temporary:
        temporary.write_text(f"zeroshop.data({text});\n", encoding="ascii")


def encode_mesh(reduced: ReducedMesh, distances: np.ndarray | None = None, limit_mm: float = 0.0) -> dict:
    """The content of a mesh file for the viewer.

    Args:
        reduced: the mesh, mm.
        distances: (V,) to the truth in mm, NaN where the distance does not count.
        limit_mm: distance of the end of the colour scale.
    """
    mesh = reduced.mesh
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    size = np.maximum(high - low, 1e-9)
    wide = len(mesh.vertices) > 65536
    content = {
        "low": [round(float(value), 4) for value in low],
        "size": [round(float(value), 4) for value in size],
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "original_faces": reduced.faces,
        "wide": wide,
        "positions": encode_array(np.rint((mesh.vertices - low) / size * 65535).astype("<u2")),
        "normals": encode_array(np.rint(mesh.vertex_normals * 127).astype("i1")),
        "index": encode_array(mesh.faces.astype("<u4" if wide else "<u2")),
    }
    if mesh.uv is not None and mesh.texture is not None:
        content["uv"] = encode_array(np.rint(np.clip(mesh.uv, 0, 1) * 65535).astype("<u2"))
        content["texture"] = encode_texture(mesh.texture)
    if reduced.colors is not None:
        content["colors"] = encode_array(reduced.colors)
    if distances is not None:
        content |= {"distances": encode_array(quantize_distances(distances, limit_mm)), "limit_mm": round(limit_mm, 4)}
    return content


def quantize_distances(distances: np.ndarray, limit_mm: float) -> np.ndarray:
    """(V,) uint8: 0 to 254 for distances from 0 to the limit, 255 where the distance does not count."""
    counted = np.clip(np.rint(np.nan_to_num(distances) / limit_mm * LARGEST), 0, LARGEST)
    return np.where(np.isfinite(distances), counted, UNSEEN).astype(np.uint8)


def encode_scene(model: SparseModel, object_from_registration: np.ndarray) -> dict:
    """The content of a scene file: cameras (centre, right, down, forward in the object frame, mm) and the coloured sparse points."""
    cameras = []
    for camera in model.cameras:
        moved = transform_camera(camera, object_from_registration)
        axes = moved.camera_from_world[:3, :3]
        half = np.array([camera.width_px, camera.height_px]) / (2 * camera.intrinsics[[0, 1], [0, 1]])
        rows = [moved.centre_in_world, axes[0] * half[0], axes[1] * half[1], axes[2]]
        cameras.append({"name": camera.name, "frame": np.round(np.concatenate(rows), 4).tolist()})
    step = max(1, -(-len(model.points) // POINTS))
    order = np.argsort(-model.track_lengths, kind="stable")[: POINTS * step : step]
    points = transform_points(model.points[order], object_from_registration)
    return {
        "cameras": cameras,
        "points": encode_array(points.astype("<f4")),
        "point_colors": encode_array(model.colors[order]),
        "all_points": len(model.points),
    }


def encode_array(values: np.ndarray) -> str:
    """The bytes of an array in base64."""
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def encode_webp(image: np.ndarray) -> bytes:
    """(height, width, 3 or 4) uint8 RGB or RGBA as WebP."""
    swapped = cv2.cvtColor(image, cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR)
    made, data = cv2.imencode(".webp", swapped, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    if not made:
        raise StepError(f"a picture of {image.shape[1]} x {image.shape[0]} px could not be written as WebP; OpenCV lacks it")
    return data.tobytes()


def encode_texture(image: np.ndarray) -> str:
    """(height, width, 3) uint8 RGB as a WebP data URL."""
    return "data:image/webp;base64," + base64.b64encode(encode_webp(image)).decode("ascii")
