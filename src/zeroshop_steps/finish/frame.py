"""Compute the object frame of a mesh. Its up direction and its scale come from the height stage.

z is the normal of the support plane, or the mean up direction of the cameras where no plane was found. x points horizontally
from the object to the first camera. The origin is the centre of the bounding box. Lengths are millimetres; if the scale is
unknown, they are units of the registration.
"""

from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.images import IMAGE_SUFFIXES
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import warn

FROM_HEIGHT = ("up_source", "scale_source", "scale", "height_m", "height_deviation_m", "height_measured_from", "height_in_registration")
ROUNDS = 6  # x depends on the box's centre, and the box on x; each round moves both by a fraction of what the last one did
STRAIGHT_DOWN = 0.1  # horizontal share of the view direction below which the first camera looks straight down (within 6 degrees)


def make_frame_record(mesh: Mesh, views: list[View], height: dict[str, Any], capture: Path) -> dict[str, Any]:
    """The content of frame.json; warns of what it says against the frame.

    Args:
        mesh: closed, in the registration frame.
        views: registered photos.
        height: content of height.json.
        capture: folder of the capture; x should point to the camera of its first photo.
    """
    frame = compute_object_frame(mesh, views, height)
    first = find_first_photo(capture) or views[0].camera.name
    frame["first_photo"] = Path(first).stem
    if Path(first).stem != Path(views[0].camera.name).stem:
        frame["warnings"].append(f"the first photo {first} has no camera; x points to {views[0].camera.name} instead")
    for warning in frame["warnings"]:
        warn(warning)
    return frame


def compute_object_frame(mesh: Mesh, views: list[View], height: dict[str, Any]) -> dict[str, Any]:
    """The content of frame.json.

    `object_from_registration` is a (4, 4) similarity to millimetres, or to registration units if the scale is unknown. It depends
    on the mesh, the cameras and the support plane only, so another registration frame gives the same object frame.

    Args:
        mesh: in the registration frame; its bounding box gives the origin.
        views: registered photos; the first one gives x.
        height: content of height.json.
    """
    z, metric = np.array(height["up"]), height["scale"] == "known"
    rotation, middle, warnings = _compute_rotation(z, mesh, views[0])
    if height["up_source"] == "camera_roll":
        warnings.append("no ground was found, so z follows how the camera was held and may lean; print under the object helps")
    scale = height["metres_per_unit"] * 1000.0 if metric else 1.0
    similarity = make_transform(scale * rotation, -scale * middle)
    residual = height["up_uncertainty"]["plane_residual"]
    return {
        "object_from_registration": similarity.tolist(),
        **{key: height[key] for key in FROM_HEIGHT},
        "unit": "mm" if metric else "registration",
        "bottom_z": float(scale * height["bottom"] + similarity[2, 3]),
        "up_uncertainty": height["up_uncertainty"] | {"plane_residual": None if residual is None else round(scale * residual, 6)},
        "first_camera": views[0].camera.name,
        "warnings": warnings,
    }


def _compute_rotation(z: np.ndarray, mesh: Mesh, view: View) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(3, 3) rotation object_from_registration, (3,) centre of the rotated box, and warnings.

    x points from that centre to the camera, and the box depends on x, so both are computed in turns.
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
    """(3,) unit x and warnings: the horizontal direction to the first camera; if it looks straight down, its image's lower side."""
    direction = view.camera.centre_in_world - centre
    horizontal = direction - z * (z @ direction)
    warnings = []
    if np.linalg.norm(horizontal) < STRAIGHT_DOWN * np.linalg.norm(direction):
        warnings.append("the first camera looks straight down, so x follows the lower side of its image")
        horizontal = view.camera.camera_from_world[1, :3]
        horizontal = horizontal - z * (z @ horizontal)
    return horizontal / np.linalg.norm(horizontal), warnings


def find_first_photo(capture: Path) -> str | None:
    """File name of a capture's first photo; None if it has none."""
    folder = capture / "images"
    names = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES) if folder.is_dir() else []
    return names[0] if names else None
