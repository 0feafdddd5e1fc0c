"""Give the mesh its object frame: up and scale are those of the height stage.

z points away from the support plane (without one, along the cameras' common up); x points horizontally from the object
to the first camera; the origin is the bounding-box centre. Lengths are millimetres, units of the registration where the
scale is unknown.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.images import IMAGE_SUFFIXES
from zeroshop_steps.geometry.meshes import Mesh, read_ply
from zeroshop_steps.geometry.registered_views import View, read_views
from zeroshop_steps.runtime.errors import warn
from zeroshop_steps.runtime.files import read_json, write_json

KEPT = ("up_source", "scale_source", "scale", "height_m", "height_deviation_m", "height_measured_from", "height_in_registration")
ROUNDS = 6  # the box turns by less than a hundredth of what x turns by, and x by a fraction of what the box's middle moves


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method\'s command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="mesh with its underside, registration frame")
    parser.add_argument("--height", type=Path, required=True, help="height.json")
    parser.add_argument("--cameras", type=Path, required=True, help="registered cameras with images and masks")
    parser.add_argument("--capture", type=Path, required=True, help="capture folder; its first photo is what x should point to")
    parser.add_argument("--out", type=Path, required=True, help="frame.json")


def run(args: argparse.Namespace) -> None:
    start_s = time.monotonic()
    mesh = read_ply(args.mesh)
    views, _ = read_views(args.cameras)
    frame = compute_object_frame(mesh, views, read_json(args.height))
    first = find_first_photo(args.capture) or views[0].camera.name
    frame["first_photo"] = Path(first).stem
    if Path(first).stem != Path(views[0].camera.name).stem:
        frame["warnings"].append(f"the first photo {first} has no camera; x points to {views[0].camera.name} instead")
    for warning in frame["warnings"]:
        warn(warning)
    write_json(args.out, frame | {"seconds": round(time.monotonic() - start_s, 2)})


def compute_object_frame(mesh: Mesh, views: list[View], height: dict[str, Any]) -> dict[str, Any]:
    """The object frame as the content of frame.json.

    `object_from_registration` is a (4, 4) similarity to millimetres (to registration units where the scale is unknown).
    Everything is computed from the mesh, the cameras and the height's plane alone, so it moves with the registration frame.

    Args:
        mesh: in the registration frame; its box gives the origin.
        views: the first one gives x.
        height: content of height.json.
    """
    z, metric = np.array(height["up"]), height["scale"] == "known"
    rotation, middle, warnings = _compute_rotation(z, mesh, views[0])
    if height["up_source"] == "camera_roll":
        warnings.append(
            "no ground was found to stand on, so z follows how the camera was held, which may lean; print under the object helps"
        )
    scale = height["metres_per_unit"] * 1000.0 if metric else 1.0
    similarity = np.eye(4)
    similarity[:3, :3] = scale * rotation
    similarity[:3, 3] = -scale * middle
    residual = height["up_uncertainty"]["plane_residual"]
    return {
        "object_from_registration": similarity.tolist(),
        **{key: height[key] for key in KEPT},
        "unit": "mm" if metric else "registration",
        "bottom_z": float(scale * height["bottom"] + similarity[2, 3]),
        "up_uncertainty": height["up_uncertainty"] | {"plane_residual": None if residual is None else round(scale * residual, 6)},
        "first_camera": views[0].camera.name,
        "warnings": warnings,
    }


def _compute_rotation(z: np.ndarray, mesh: Mesh, view: View) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(3, 3) rotation object_from_registration, (3,) middle of the box after it, and warnings.

    x leads from that middle to the camera, and the box follows x: a few rounds settle both.
    """
    centre = mesh.vertices.mean(0)
    for _ in range(ROUNDS):
        x, warnings = _point_to_camera(z, centre, view)
        rotation = np.stack([x, np.cross(z, x), z])
        turned = mesh.vertices @ rotation.T
        middle = (turned.min(0) + turned.max(0)) / 2
        centre = middle @ rotation
    return rotation, middle, warnings


def _point_to_camera(z: np.ndarray, centre: np.ndarray, view: View) -> tuple[np.ndarray, list[str]]:
    """(3,) unit x: the horizontal direction from the object's centre to the first camera; from above, its image's lower side."""
    direction = view.camera.centre_in_world - centre
    horizontal = direction - z * (z @ direction)
    warnings = []
    if np.linalg.norm(horizontal) < 0.1 * np.linalg.norm(direction):
        warnings.append("the first camera looks straight down, so x follows the lower side of its image")
        horizontal = view.camera.camera_from_world[1, :3]
        horizontal = horizontal - z * (z @ horizontal)
    return horizontal / np.linalg.norm(horizontal), warnings


def find_first_photo(capture: Path) -> str | None:
    """The name of a capture's first picture; None without any."""
    folder = capture / "images"
    names = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES) if folder.is_dir() else []
    return names[0] if names else None
