"""Take the scale from cameras that come with the capture: the metres between them, compared with the registration's unit.

The centres of the registered cameras are laid onto the given ones by a similarity; a few that are far off do not count. Its deviation
follows from what is left between them, and is at least what was stated of the cameras' places.
"""

import argparse
from pathlib import Path

import numpy as np

from zeroshop_steps.capture.cameras_json import FILE, read_given_cameras
from zeroshop_steps.geometry.cameras.pinhole import LEAST_PAIRS, find_centre, fit_similarity_robustly
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_points
from zeroshop_steps.height.record import RegisteredObject, Scale, add_common_arguments, write_height
from zeroshop_steps.runtime.errors import StepError

LEAST_CAMERAS = LEAST_PAIRS + 1  # those that define a similarity, and one that checks it
MOST_OFF = 0.1  # median error, as a share of the cameras' spread, from which on the cameras are other ones

METHOD = {"rank": 3, "given_cameras": True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Write height.json."""
    write_height(args, "given_cameras", measure_scale, "the given cameras have another unit than metres")


def measure_scale(registered: RegisteredObject) -> Scale | None:
    """The metres of the given cameras; None where their unit is unknown.

    Raises:
        StepError: no cameras came with the capture, too few of them are registered, or they are other ones.
    """
    path = registered.capture / FILE
    if not path.is_file():
        raise StepError(f"{path} does not exist: no cameras came with this capture; give the height, or use another height_method")
    given = read_given_cameras(path)
    if not given.metric:
        return None
    poses = {Path(name).stem: pose for name, pose in given.poses.items()}
    pairs = [(view.camera.centre_in_world, poses[stem]) for view in registered.views if (stem := Path(view.camera.name).stem) in poses]
    if len(pairs) < LEAST_CAMERAS:
        raise StepError(
            f"{len(pairs)} registered cameras have a given pose in {path}, {LEAST_CAMERAS} are needed; use another height_method"
        )
    source = np.array([centre for centre, _ in pairs])
    target = np.array([find_centre(pose) for _, pose in pairs])
    similarity, kept = fit_similarity_robustly(source, target)
    errors_m = np.linalg.norm(transform_points(source, similarity) - target, axis=1)
    spread_m = float(np.sqrt(((target[kept] - target[kept].mean(0)) ** 2).sum()))
    if float(np.median(errors_m)) > MOST_OFF * spread_m / np.sqrt(kept.sum()):
        raise StepError(
            f"{path}: the given cameras lie {float(np.median(errors_m)):.3g} m off the registered ones in the median: they belong to"
            " another recording, or the registration is wrong; use another height_method"
        )
    # Three unknowns of the shift, three of the turn and one of the scale are fitted to three coordinates of each camera.
    free = max(3 * int(kept.sum()) - 7, 1)
    left_m = float(np.sqrt((errors_m[kept] ** 2).sum() / free))
    deviation_m = max(left_m, given.position_deviation_m or 0.0)
    evidence = {
        "source": given.source,
        "cameras": int(kept.sum()),
        "left_out": int((~kept).sum()),
        "left_m": round(left_m, 6),
        "stated_deviation_m": given.position_deviation_m,
    }
    return Scale("given_cameras", compute_scale(similarity), deviation_m / spread_m, evidence)
