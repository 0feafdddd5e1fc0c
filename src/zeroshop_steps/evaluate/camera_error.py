"""Compare registered cameras with the true ones of a virtual capture, a rendered film or a calibrated dataset.

The frame of a registration is arbitrary, so the cameras are first aligned by the similarity that best maps their centres. Writes
a JSON and, beside it, a tidy CSV with one row per measurement.
"""

import argparse
import contextlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere, fit_object_sphere
from zeroshop_steps.geometry.cameras.pinhole import Camera, align_to_truth, pair_with_truth, read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import read_deviations, read_object_masks, read_views
from zeroshop_steps.geometry.cameras.transforms import compute_scale, move_similarity, transform_points
from zeroshop_steps.register.refinement.camera_deviation import ENDS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.runtime.tables import write_table
from zeroshop_steps.synthetic.film_truth import read_true_cameras

READS_FAILURES = True


@dataclass(frozen=True)
class CameraError:
    """Errors after the alignment.

    Attributes:
        names: stems of the images that both have.
        centre_mm: (N,) distances between camera centres.
        rotation_deg: (N,) angles between camera orientations.
        focal_ratio: mean ratio of estimated to true focal length.
    """

    names: tuple[str, ...]
    centre_mm: np.ndarray
    rotation_deg: np.ndarray
    focal_ratio: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--cameras", type=Path, required=True, help="registered cameras")
    parser.add_argument("--truth", type=Path, required=True, help="COLMAP model of the true cameras, in millimetres; of a film, its truth")
    parser.add_argument("--film-capture", type=Path, help="the capture that was made from the film, which names its frames")
    parser.add_argument("--out", type=Path, required=True, help="JSON to write; a CSV of the same name goes beside it")


def run(args: argparse.Namespace) -> None:
    """Write the JSON and the CSV; for a failed registration, its reason and the errors of the rejected model, if there is one."""
    truth = read_true_cameras(args.film_capture, args.truth) if args.film_capture else read_sparse_model(args.truth).cameras
    record: dict = {"images": len(truth), "registered": 0}
    failure = read_failure(args.cameras)
    record |= {"status": "failed", "reason": failure.reason} if failure else {"status": "ok"}
    model = args.cameras / ("rejected" if failure else "sparse")
    if (model / "cameras.bin").is_file():
        error = compare_cameras(read_sparse_model(model).cameras, truth)
        record |= {
            "registered": len(error.names),
            "mean_centre_error_mm": float(error.centre_mm.mean()),
            "max_centre_error_mm": float(error.centre_mm.max()),
            "mean_rotation_error_deg": float(error.rotation_deg.mean()),
            "max_rotation_error_deg": float(error.rotation_deg.max()),
            "focal_ratio": error.focal_ratio,
        }
        per_camera = zip(error.names, error.centre_mm, error.rotation_deg, strict=True)
        record["cameras"] = {name: {"centre_error_mm": float(c), "rotation_error_deg": float(r)} for name, c, r in per_camera}
        if not failure and (args.cameras / "masks").is_dir():
            with contextlib.suppress(StepError):  # cameras so wrong that what the masks show has no place
                add_object_errors(record, args.cameras, truth)
    write_json(args.out, record)
    summary = {key: value for key, value in record.items() if isinstance(value, int | float)}
    figures = {"all": summary, **record.get("cameras", {})}
    rows = [{"camera": name, "measure": key, "value": value} for name, values in figures.items() for key, value in values.items()]
    write_table(args.out.with_suffix(".csv"), rows, ["camera", "measure", "value"])


def add_object_errors(record: dict, folder: Path, truth: tuple[Camera, ...]) -> None:
    """Complete a record in place: how far off the object lies in each view, and how far the registration expected it to, in pixels."""
    views, _ = read_views(folder)
    pairs = pair_with_truth([view.camera for view in views], truth)
    kept = [view for view in views if view.camera.name in {camera.name for camera, _ in pairs}]
    sphere = fit_object_sphere([view.camera for view in kept], read_object_masks(kept))
    errors = measure_object_errors_px(pairs, sphere)
    record["object_error_px"] = float(np.sqrt((errors**2).mean()))
    for view, error in zip(kept, errors, strict=True):
        record["cameras"][Path(view.camera.name).stem]["object_error_px"] = float(error)
    stated = read_deviations(folder)
    if stated:
        deviations = np.array([stated[view.camera.name] for view in kept])
        record["deviation_px"] = float(np.sqrt((deviations**2).mean()))
        for view, deviation in zip(kept, deviations, strict=True):
            record["cameras"][Path(view.camera.name).stem]["deviation_px"] = float(deviation)


def measure_object_errors_px(pairs: list[tuple[Camera, Camera]], sphere: ObjectSphere) -> np.ndarray:
    """(N,) by how many pixels an object lies off in each view, in its middle and at its ends: as root of the mean square.

    The world of the true cameras is moved such that it lies off least in all views together. What is measured is what
    `register.refinement.camera_deviation` predicts.

    Args:
        pairs: registered and true camera of each view.
        sphere: the object's, in the registration's world.
    """
    found, places, truth_from_registration = [], [], align_to_truth(pairs)
    for camera, _ in pairs:
        ends = sphere.centre + sphere.radius * ENDS @ camera.camera_from_world[:3, :3]
        found.append(camera.project(ends)[0])
        places.append(transform_points(ends, truth_from_registration))
    centre, size = places[0][0], float(np.linalg.norm(places[0][1] - places[0][0]))

    def miss(step: np.ndarray) -> np.ndarray:
        move = move_similarity(np.eye(4), step, centre, size)
        seen = [camera.project(transform_points(ends, move))[0] for (_, camera), ends in zip(pairs, places, strict=True)]
        return (np.array(seen) - found).ravel()

    missed = miss(least_squares(miss, np.zeros(7)).x).reshape(len(pairs), -1, 2)
    return np.sqrt((missed**2).sum(2).mean(1))


def compare_cameras(estimated: tuple[Camera, ...], truth: tuple[Camera, ...]) -> CameraError:
    """Align `estimated` to `truth` by the centres of the cameras that both have, matched by image stem, and measure the rest.

    Raises:
        StepError: fewer than three common cameras.
    """
    pairs = pair_with_truth(estimated, truth)
    centres = np.array([camera.centre_in_world for camera, _ in pairs])
    true_centres = np.array([camera.centre_in_world for _, camera in pairs])
    truth_from_estimate = align_to_truth(pairs)
    scale = compute_scale(truth_from_estimate)
    aligned = transform_points(centres, truth_from_estimate)
    rotation = truth_from_estimate[:3, :3] / scale
    angles = []
    for camera, true_camera in pairs:
        between = camera.camera_from_world[:3, :3] @ rotation.T @ true_camera.camera_from_world[:3, :3].T
        # By the chord instead of the trace: arccos loses half of the digits at small angles.
        angles.append(np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(between - np.eye(3)) / np.sqrt(8), 0, 1))))
    return CameraError(
        tuple(Path(camera.name).stem for camera, _ in pairs),
        np.linalg.norm(aligned - true_centres, axis=1),
        np.array(angles),
        float(np.mean([camera.intrinsics[0, 0] / true_camera.intrinsics[0, 0] for camera, true_camera in pairs])),
    )
