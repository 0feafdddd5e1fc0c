"""How surely each camera of a registration is held: `camera_deviation.csv` beside it, of the model and the masks as they were written."""

from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import DEVIATIONS, View, read_views
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.geometry.support.scene_support import find_focus
from zeroshop_steps.register.refinement.covariance import CameraDeviations, estimate_deviations
from zeroshop_steps.register.scene.record import Evidence, Finding
from zeroshop_steps.register.silhouettes.bundle_adjustment import SilhouetteAdjustment
from zeroshop_steps.register.silhouettes.coherence import bound_object
from zeroshop_steps.register.silhouettes.model_adjustment import read_tracks
from zeroshop_steps.register.silhouettes.state import NO_TRACKS, Tracks
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import write_table

LOOSE_SHARE = 0.006
"""Mean deviation of the cameras' centres, of their distance, at strength 1. In 111 models of 11 rendered captures, with keypoints not yet
refined, it is at most 0.0054 in right ones (95 %: 0.0039), and 0.0045 to 0.0086 where cameras are bent by 1.6 to 4 % of the diameter."""
USUAL_SHARE = 0.25  # of an image's shorter side that an object's radius has, where no mask shows it


def write_deviations(folder: Path, by_outlines: bool) -> dict[str, Any]:
    """Write camera_deviation.csv into a folder with images/, sparse/ and perhaps masks/.

    Args:
        by_outlines: whether the masks' rims had a part in the cameras; then they do in the deviations.

    Returns:
        What registration.json says of them. Nothing is written, and this is empty, where there are no masks and the cameras look away
        from each other, at no object: `record_view_coverage` advises what to do then.
    """
    try:
        found = measure_deviations(read_views(folder)[0], folder / "sparse", by_outlines)
    except StepError:
        return {}
    rows = [
        {"image": name, "deviation_px": f"{px:.4f}", "rotation_deg": f"{angle:.5f}", "centre_share": f"{share:.6f}"}
        for name, px, angle, share in zip(found.names, found.object_px, found.rotation_deg, found.centre_share, strict=True)
    ]
    write_table(folder / DEVIATIONS, rows)
    usual, largest = np.median(found.object_px), found.object_px.max()
    return {"deviation_px": {"median": round(float(usual), 3), "largest": round(float(largest), 3)}}


def check_deviations(folder: Path, by_outlines: bool) -> Evidence:
    """How loosely the cameras of a folder are held; arguments as of `write_deviations`."""
    try:
        share = float(measure_deviations(read_views(folder)[0], folder / "sparse", by_outlines).centre_share.mean())
    except StepError:
        return Evidence()
    found = f"the standard deviation of a camera's place is {share:.1%} of its distance in the mean"
    return Evidence(findings=(Finding("deviation", share / LOOSE_SHARE, found),))


def measure_deviations(views: list[View], sparse: Path, by_outlines: bool) -> CameraDeviations:
    """Deviations of the cameras of a registration, whose sparse model lies in a folder.

    Raises:
        StepError: there are no masks, and the cameras look away from each other.
    """
    model = read_reconstruction(sparse)
    cameras = [view.camera for view in views]
    ids, tracks = read_tracks(model, cameras)
    points = np.array([model.points3D[point_id].xyz for point_id in ids]).reshape(-1, 3)
    tracks, points = _keep_in_front(cameras, tracks, points)
    centre, radius, told = *_find_object(views), None
    if by_outlines:
        adjustment = SilhouetteAdjustment(cameras, {view.camera.name: view.mask() for view in views}, NO_TRACKS)
        centre, radius, told = adjustment.centre, adjustment.radius, adjustment.measure_information()
    return estimate_deviations(cameras, tracks, points, centre, radius, told)


def _keep_in_front(cameras: list[Camera], tracks: Tracks, points: np.ndarray) -> tuple[Tracks, np.ndarray]:
    """The tracks without observations of points behind their camera, and without points that fewer than two views are left of."""
    axes = np.array([camera.camera_from_world[2] for camera in cameras])
    depth = (axes[tracks.view, :3] * points[tracks.point]).sum(1) + axes[tracks.view, 3]
    kept = depth > 0
    kept &= np.bincount(tracks.point[kept], minlength=len(points))[tracks.point] > 1
    used, numbers = np.unique(tracks.point[kept], return_inverse=True)
    return Tracks(tracks.view[kept], numbers, tracks.pixels[kept]), points[used]


def _find_object(views: list[View]) -> tuple[np.ndarray, float]:
    """Centre and radius of a sphere about what the masks show; without masks, about what all cameras look at."""
    masks = [(view.camera, view.mask()) for view in views if view.mask_path is not None]
    shown = [(camera, mask) for camera, mask in masks if mask.any()]
    if len(shown) > 1:
        return bound_object([camera for camera, _ in shown], [mask for _, mask in shown])
    cameras = [view.camera for view in views]
    centre = find_focus(cameras)
    sides = [
        USUAL_SHARE * min(camera.width_px, camera.height_px) / camera.intrinsics[0, 0] * np.linalg.norm(centre - camera.centre_in_world)
        for camera in cameras
    ]
    return centre, float(np.median(sides))
