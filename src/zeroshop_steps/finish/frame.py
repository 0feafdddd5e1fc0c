"""Give the mesh its object frame and metric scale.

z is the normal of the support plane, fitted to the sparse points around the object, or the cameras' common up where
there is no plane; x points horizontally from the object to the first camera; the origin is the bounding-box centre.
The known height of the object gives millimetres. An unknown scale is never guessed.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from zeroshop_steps.errors import StepError
from zeroshop_steps.files import read_json, write_json
from zeroshop_steps.finish.support_plane import SupportPlane, background_points, fit_support_plane, up_from_roll
from zeroshop_steps.finish.views import View, read_views
from zeroshop_steps.images import IMAGE_SUFFIXES
from zeroshop_steps.meshes import Mesh, read_ply

TOP_SHARE = 2e-4  # share of the surface's area that may stick out above the measured top: spikes, not the object


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method\'s command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="cleaned mesh, registration frame")
    parser.add_argument("--cameras", type=Path, required=True, help="registered cameras with images, masks and sparse points")
    parser.add_argument("--capture", type=Path, required=True, help="capture folder; its capture.json holds the known height")
    parser.add_argument("--out", type=Path, required=True, help="frame.json")


def run(args: argparse.Namespace) -> None:
    start_s = time.monotonic()
    mesh = read_ply(args.mesh)
    views, model = read_views(args.cameras)
    plane = fit_support_plane(model.points[background_points(model.points, views)], mesh.vertices, views)
    height_m = known_height_m(args.capture / "capture.json")
    frame = object_frame(mesh, views, plane, height_m)
    frame |= _first_camera_note(args.capture, views)
    if frame["scale_source"] == "unknown":
        print(
            "WARNING: the scale is unknown: no height is given, so the mesh keeps the registration's arbitrary scale. "
            "Give the object's height in metres as height_m in config/objects.tsv.",
            file=sys.stderr,
        )
    if frame["warnings"]:
        print("WARNING: " + "; ".join(frame["warnings"]), file=sys.stderr)
    write_json(args.out, frame | {"seconds": round(time.monotonic() - start_s, 2)})


def known_height_m(path: Path) -> float | None:
    """The known height from capture.json, None when it is unknown."""
    height_m = read_json(path).get("known_height_m")
    if height_m is None:
        return None
    if not isinstance(height_m, int | float) or not 0.001 <= height_m <= 10.0:
        raise StepError(f"{path}: known_height_m is {height_m}; expected metres between 0.001 and 10")
    return float(height_m)


def object_frame(mesh: Mesh, views: list[View], plane: SupportPlane | None, height_m: float | None) -> dict:
    """The object frame as the content of frame.json.

    `object_from_registration` is a (4, 4) similarity to millimetres (to registration units where the scale is unknown).
    Everything is computed from the mesh, the cameras and the plane alone, so it moves with the registration frame.
    """
    z, up_certainty = (plane.normal, None) if plane else up_from_roll(views)
    x, warnings = _towards_camera(z, mesh, views[0])
    rotation = np.stack([x, np.cross(z, x), z])
    turned = mesh.vertices @ rotation.T
    low_z, high_z = robust_extent(turned[:, 2], mesh)
    bottom_z = plane.offset if plane else low_z
    extent = high_z - bottom_z
    if extent <= 0:
        raise StepError("the mesh has no height above its support plane: the reconstruction is flat or stands on its head")
    scale = height_m * 1000.0 / extent if height_m else 1.0
    similarity = np.eye(4)
    similarity[:3, :3] = scale * rotation
    similarity[:3, 3] = -scale * (turned.min(0) + turned.max(0)) / 2
    unit = "mm" if height_m else "registration"
    return {
        "object_from_registration": similarity.tolist(),
        "up_source": "support_plane" if plane else "camera_roll",
        "scale_source": "known_height" if height_m else "unknown",
        "scale": "known" if height_m else "unknown",
        "unit": unit,
        "height_m": height_m,
        "height_measured_from": "support plane to the mesh's top" if plane else "the mesh's bottom to its top",
        "height_in_registration": float(extent),
        "bottom_z": float(scale * bottom_z + similarity[2, 3]),
        "up_uncertainty": {
            "plane_inliers": plane.inliers if plane else 0,
            "plane_residual": round(scale * plane.residual, 6) if plane else None,
            "deviation_deg": round(plane.normal_deviation_deg, 5) if plane else None,
            "roll_certainty": None if up_certainty is None else round(up_certainty, 4),
        },
        "first_camera": views[0].camera.name,
        "warnings": warnings,
    }


def robust_extent(heights: np.ndarray, mesh: Mesh) -> tuple[float, float]:
    """Lowest and highest of the (V,) heights, but for spikes that hold less than `TOP_SHARE` of the area each."""
    areas = mesh.as_trimesh().area_faces
    weights = np.zeros(len(heights))
    for corner in range(3):
        np.add.at(weights, mesh.faces[:, corner], areas / 3)
    order = np.argsort(heights)
    below = np.cumsum(weights[order]) / weights.sum()
    first, last = np.searchsorted(below, TOP_SHARE), np.searchsorted(below, 1.0 - TOP_SHARE)
    return float(heights[order[first]]), float(heights[order[min(last, len(order) - 1)]])


def _towards_camera(z: np.ndarray, mesh: Mesh, view: View) -> tuple[np.ndarray, list[str]]:
    """(3,) unit x: the horizontal direction from the object's centre to the first camera; from above, its image's lower side."""
    direction = view.camera.centre_in_world - (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    horizontal = direction - z * (z @ direction)
    warnings = []
    if np.linalg.norm(horizontal) < 0.1 * np.linalg.norm(direction):
        warnings.append("the first camera looks straight down, so x follows the lower side of its image")
        horizontal = view.camera.camera_from_world[1, :3]
        horizontal = horizontal - z * (z @ horizontal)
    return horizontal / np.linalg.norm(horizontal), warnings


def _first_camera_note(capture: Path, views: list[View]) -> dict:
    folder = capture / "images"
    names = sorted(path.stem for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES) if folder.is_dir() else []
    registered = Path(views[0].camera.name).stem
    if names and names[0] != registered:
        print(f"WARNING: the first photo {names[0]} is not registered; x points to {registered} instead", file=sys.stderr)
    return {"first_photo": names[0] if names else registered}
