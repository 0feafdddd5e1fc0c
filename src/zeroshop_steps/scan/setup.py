"""What a user says of a scan: the box around the object, the sensor, and where the camera can be brought."""

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.scan.arm.arm_reach import ArmReach, CameraHand
from zeroshop_steps.scan.arm.kinematics import ARMS, JOINTS, Capsule, find_arm
from zeroshop_steps.scan.assumed_surface import AssumedSurface
from zeroshop_steps.scan.measured_surface import MeasuredSurface
from zeroshop_steps.scan.pinhole_depth import pinhole_camera
from zeroshop_steps.scan.reach import Limits, Reach
from zeroshop_steps.scan.recorder import ScanRecorder
from zeroshop_steps.scan.session import Scan
from zeroshop_steps.scan.surface_map import SurfaceMap
from zeroshop_steps.scan.viewpoints import ViewSphere
from zeroshop_steps.scan.workspace import Box

POSE_NUMBERS = ("X", "Y", "Z", "QX", "QY", "QZ", "QW")
UNIT_QUATERNION = 0.01  # by which a quaternion's length may differ from 1: people round to three digits
HAND_RADIUS_M = 0.05  # of what is assumed around the line from the flange to the camera


def add_setup_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that say what is scanned, and where the camera can be brought."""
    box_help = "middle and sides of a box around the object, on the table, metres, in the frame of the poses"
    parser.add_argument("--box", type=float, nargs=6, required=True, metavar=("X", "Y", "Z", "DX", "DY", "DZ"), help=box_help)
    parser.add_argument("--without-depth", action="store_true", help="there is no depth: plan by the box alone")
    parser.add_argument("--least-views", type=int, default=3, help="views wanted of each part of the surface (default: %(default)s)")
    eye_help = "from the camera to the depth sensor's projector or second camera, along x, metres (default: not known)"
    parser.add_argument("--baseline-m", type=float, help=eye_help)
    parser.add_argument("--nearest-m", type=float, default=0.25, help="least distance from the object's middle (default: %(default)s)")
    parser.add_argument("--least-elevation-deg", type=float, default=10.0, help="of views, above the table (default: %(default)s)")
    parser.add_argument("--arm", choices=list(ARMS), help="whose base frame the poses are in; without it, --reach-m limits views")
    hand_help = "of the camera on the arm's flange, metres and a quaternion (hand-eye calibration)"
    parser.add_argument("--flange-from-camera", type=float, nargs=7, metavar=POSE_NUMBERS, help=hand_help)
    parser.add_argument("--reach-m", type=float, help="without --arm: greatest distance of the camera from the frame's origin")


def make_box(args: argparse.Namespace) -> Box:
    """The box around the object. Raises StepError where it is none."""
    return Box.around(np.array(args.box[:3]), np.array(args.box[3:]))


def check_least_views(count: int) -> None:
    """Raise StepError for a number out of range."""
    if not 1 <= count <= 20:
        raise StepError(f"--least-views is {count}; expected 1 to 20")


def make_map(box: Box, least_views: int, without_depth: bool, second_eye_m: np.ndarray | None) -> SurfaceMap:
    """An empty map of a box. Raises StepError for a number out of range."""
    check_least_views(least_views)
    return AssumedSurface(box, least_views) if without_depth else MeasuredSurface(box, least_views, second_eye_m=second_eye_m)


def make_surface(args: argparse.Namespace) -> SurfaceMap:
    """The empty map that the arguments describe. Raises StepError for a number out of range."""
    eye_m = None if args.baseline_m is None else np.array([args.baseline_m, 0.0, 0.0])
    return make_map(make_box(args), args.least_views, args.without_depth, eye_m)


def make_scan(args: argparse.Namespace, recorder: ScanRecorder, lens: Lens) -> Scan:
    """The scan with a lens's viewpoints; views that the recorder has are taken in."""
    camera = pinhole_camera(lens, np.eye(4))
    sphere = ViewSphere(camera, least_elevation_deg=args.least_elevation_deg, nearest_m=args.nearest_m)
    return Scan(recorder, make_surface(args), sphere)


def make_reach(args: argparse.Namespace) -> Reach:
    """Where the camera can be brought; an arm's posture now is not known, and taken for its home.

    Raises:
        StepError: an arm has no calibration of its hand.
    """
    box = make_box(args)
    if args.arm is None:
        base_m = None if args.reach_m is None else np.zeros(3)
        return Limits(base_m, np.inf if args.reach_m is None else args.reach_m, float(box.low_m[2]), box)
    if args.flange_from_camera is None:
        raise StepError(
            f"--arm {args.arm} needs --flange-from-camera, the camera's pose on its flange, x y z qx qy qz qw: calibrate the hand"
        )
    flange_from_camera = read_pose(args.flange_from_camera, "--flange-from-camera")
    # Between the flange and the camera is its mount; what else a hand carries is not known here.
    mount = Capsule(JOINTS, (0.0, 0.0, 0.0), tuple(flange_from_camera[:3, 3].tolist()), HAND_RADIUS_M)
    arm = find_arm(args.arm)
    return ArmReach(arm, CameraHand(flange_from_camera, (mount,)), np.eye(4), float(box.low_m[2]), box, np.array(arm.home_rad))


def read_pose(numbers: Sequence[float], name: str) -> np.ndarray:
    """(4, 4) of x, y, z, qx, qy, qz, qw. Raises StepError where the quaternion is none."""
    length = float(np.linalg.norm(numbers[3:]))
    if not np.isfinite(numbers).all() or abs(length - 1.0) > UNIT_QUATERNION:
        raise StepError(f"{name} has a quaternion of length {length:g}; expected x y z qx qy qz qw with length 1, metres")
    return make_transform(Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3])
