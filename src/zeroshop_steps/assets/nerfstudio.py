"""Photos, masks and cameras as nerfstudio reads them: transforms.json, in the mesh's frame and metres, z up.

nerfstudio's cameras look along -z with y up (OpenGL), so y and z are turned over. Masks are white where pixels count.
"""

import argparse
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.assets.object_frame import read_object_from_registration
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.cameras.transforms import OPENCV_FROM_OPENGL, transform_camera, transform_points
from zeroshop_steps.geometry.meshes.metric_mesh import add_mesh_arguments
from zeroshop_steps.runtime.files import atomic_directory, write_json

POINTS = "sparse_pc.ply"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_mesh_arguments(parser)
    parser.add_argument("--cameras", type=Path, required=True, help="the registration's cameras, images and masks")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Write one folder."""
    similarity = read_object_from_registration(args.mesh, args.unknown_scale)
    views, model = read_views(args.cameras)
    with atomic_directory(args.out) as folder:
        frames = [_write_frame(folder, view, similarity) for view in views]
        _write_points(folder / POINTS, transform_points(model.points, similarity))
        # One lens may have several cameras after undistortion, so every frame has its own numbers.
        write_json(folder / "transforms.json", {"camera_model": "OPENCV", "ply_file_path": POINTS, "frames": frames})
    print(f"nerfstudio: {len(frames)} photos in {args.out}", file=sys.stderr)


def describe_frame(camera: Camera, similarity: np.ndarray) -> dict[str, Any]:
    """Lens and pose of a photo: `transform_matrix` is world_from_camera, OpenGL axes, metres.

    Args:
        camera: in the registration's frame.
        similarity: (4, 4) from that frame to the mesh's, in metres.
    """
    moved = transform_camera(camera, similarity)
    fx, fy, cx, cy = moved.pinhole_params
    lens = {"w": moved.width_px, "h": moved.height_px, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
    world_from_camera = np.linalg.inv(moved.camera_from_world) @ OPENCV_FROM_OPENGL
    return {**lens, **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0), "transform_matrix": world_from_camera.tolist()}


def _write_frame(folder: Path, view: View, similarity: np.ndarray) -> dict[str, Any]:
    """Copy a photo and its mask. Returns its entry."""
    name = view.camera.name
    places = {"file_path": (view.image_path, f"images/{name}")}
    if view.mask_path is not None:
        places["mask_path"] = (view.mask_path, f"masks/{view.mask_path.name}")
    for source, place in places.values():
        (folder / place).parent.mkdir(exist_ok=True)
        shutil.copyfile(source, folder / place)
    return {**{key: place for key, (_, place) in places.items()}, **describe_frame(view.camera, similarity)}


def _write_points(path: Path, points: np.ndarray) -> None:
    """(N, 3) points as a PLY without faces, from which splats may start."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"] + ["end_header", ""]
    path.write_bytes("\n".join(header).encode() + points.astype("<f4").tobytes())
