"""What all height methods share: their options, and height.json with the object's height and the scale of the registration."""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.capture.known_height import read_known_height_m
from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_DEVIATIONS
from zeroshop_steps.geometry.cameras.registered_views import View, read_mask_record, read_views
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.height.object_pose import ObjectPose, measure_object_pose
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import read_json, write_json

UNKNOWN = (
    "the scale is unknown: no height is given, so the mesh keeps the registration's arbitrary scale. Give the object's height in "
    "metres as height_m in config/objects.tsv, or measure it with a printed board (config/README.md)."
)
RULER_M = 0.0005  # standard deviation of a height that is read off a ruler
CONTRADICTION = 0.03
"""Share by which a known height must differ from the measured one to contradict it, and by AGREEING_DEVIATIONS as well."""
BULGE = 0.02  # of the height: from here on a warning says that assumed surface lies above the top
BULGES = (
    "the mesh reaches {:.0%} of the object's height above the surface that was measured, like a lid over a plain hollow; that part does"
    " not count for the height"
)


@dataclass(frozen=True)
class Scale:
    """The scale of a registration.

    Attributes:
        source: what it comes from, as it stands in the product's JSON.
        metres_per_unit: metres per unit of the registration.
        deviation: its relative standard deviation: 0.01 is one per cent.
        evidence: the method's own figures, for height.json.
    """

    source: str
    metres_per_unit: float
    deviation: float
    evidence: dict[str, Any]


@dataclass(frozen=True)
class RegisteredObject:
    """What a method measures: the object's pose, its registered views, and the capture that they come from."""

    pose: ObjectPose
    views: list[View]
    cameras: Path
    capture: Path
    known_height_m: float | None


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that all height methods share."""
    parser.add_argument("--mesh", type=Path, required=True, help="cleaned mesh, registration frame")
    parser.add_argument("--cameras", type=Path, required=True, help="registered cameras with images, masks and sparse points")
    parser.add_argument("--capture", type=Path, required=True, help="capture folder; capture.json of a rendered one holds the height")
    parser.add_argument("--height-m", type=float, help="height of the standing object in metres, by a ruler; left out where unknown")
    parser.add_argument(
        "--stereo", type=Path, nargs="?", help="seeds.npz: surface that neither stereo nor an outline measured does not count for the top"
    )
    parser.add_argument("--out", type=Path, required=True, help="height.json")


def write_height(
    args: argparse.Namespace, method: str, measure: Callable[[RegisteredObject], Scale | None], else_wrong: str | None = None
) -> None:  # fmt: skip
    """Measure with `measure`, which gives the scale or None where it stays unknown, and write height.json.

    Args:
        args: with `add_common_arguments`.
        method: its name.
        measure: the method.
        else_wrong: what may be wrong, besides the known height, where both differ; None if they are not to be compared.
    """
    start_s = time.monotonic()
    views, model = read_views(args.cameras)
    pose = measure_object_pose(_read_mesh(args, views), views, model, read_mask_record(args.cameras))
    if pose.top_of_mesh - pose.top > BULGE * pose.extent:
        warn(BULGES.format((pose.top_of_mesh - pose.top) / pose.extent))
    registered = RegisteredObject(
        pose, views, args.cameras, args.capture, read_known_height_m(args.capture / "capture.json", args.height_m)
    )
    scale = measure(registered)
    if scale and else_wrong:
        check_against_known_height(scale, registered, else_wrong)
    if scale and args.stereo and (line := compare_with_depth(scale, args.stereo)):
        warn(line)
    content = {
        "method": method,
        **describe_height(pose, scale),
        "known_height_m": registered.known_height_m,
        "seconds": round(time.monotonic() - start_s, 2),
    }
    write_json(args.out, content)
    if content["scale"] == "unknown":
        warn(UNKNOWN)
    else:
        print(format_height(content), file=sys.stderr)


def _read_mesh(args: argparse.Namespace, views: list[View]) -> Mesh:
    """The mesh, with the support of its surface as quality where stereo is given."""
    mesh = read_ply(args.mesh)
    if args.stereo is None:
        return mesh
    from zeroshop_steps.geometry.observation.support_classes import MEASURED
    from zeroshop_steps.geometry.observation.vertex_support import classify_surface_support
    from zeroshop_steps.surface.mvs.seeds import read_confirmed_points

    return replace(mesh, quality=classify_surface_support(mesh, views, read_confirmed_points(args.stereo, views)) / MEASURED)


def check_against_known_height(scale: Scale, registered: RegisteredObject, else_wrong: str) -> None:
    """Raise StepError where a known height contradicts the measured one: nothing else reveals a wrong unit or a wrong print."""
    if registered.known_height_m is None:
        return
    measured_m = registered.pose.extent * scale.metres_per_unit
    deviation = np.linalg.norm([scale.deviation, registered.pose.deviation / registered.pose.extent, RULER_M / registered.known_height_m])
    difference = measured_m / registered.known_height_m - 1.0
    if abs(difference) > max(CONTRADICTION, AGREEING_DEVIATIONS * float(deviation)):
        raise StepError(
            f"by {scale.source} the object is {measured_m:.4f} m high, by its known height {registered.known_height_m:.4f} m: {else_wrong},"
            " or height_m is wrong"
        )


def compare_with_depth(scale: Scale, stereo: Path) -> str | None:
    """A warning where depth images that came with the photos put the size of a unit elsewhere; None where they agree, or there are none."""
    record = stereo.with_name("stereo.json")
    given = read_json(record).get("given_depth") if record.is_file() else None
    ratio = given["mm_per_unit"] / (1000.0 * scale.metres_per_unit) if given and given.get("mm_per_unit") else 1.0
    if abs(ratio - 1.0) <= CONTRADICTION:
        return None
    return (
        f"by the depth images all is {ratio:.3g} times as large as by {scale.source}, which counts: one of them has another unit (cameras"
        " in metres, depth_step_mm)"
    )


def describe_height(pose: ObjectPose, scale: Scale | None) -> dict[str, Any]:
    """The content of height.json. `up`, `bottom` and `top` are in the registration frame and its unit."""
    plane = pose.plane
    height_m = pose.extent * scale.metres_per_unit if scale else None
    deviation = float(np.hypot(pose.deviation / pose.extent, scale.deviation)) if scale else None
    return {
        "scale": "known" if scale else "unknown",
        "scale_source": scale.source if scale else "unknown",
        "height_m": height_m,
        "height_deviation_m": height_m * deviation if height_m is not None and deviation is not None else None,
        "metres_per_unit": scale.metres_per_unit if scale else None,
        "metres_per_unit_deviation_share": scale.deviation if scale else None,
        "up": pose.up.tolist(),
        "up_source": "support_plane" if plane else "camera_roll",
        "bottom": pose.bottom,
        "top": pose.top,
        "top_of_mesh": pose.top_of_mesh,
        "height_in_registration": pose.extent,
        "height_in_registration_deviation": pose.deviation,
        "height_measured_from": "support plane to the surface's top" if plane else "the surface's bottom to its top",
        "up_uncertainty": {
            "plane_inliers": plane.inliers if plane else 0,
            "plane_residual": plane.residual if plane else None,
            "deviation_deg": round(plane.normal_deviation_deg, 5) if plane else None,
            "roll_certainty": None if pose.roll_certainty is None else round(pose.roll_certainty, 4),
        },
        "evidence": scale.evidence if scale else {},
    }


def format_height(content: dict[str, Any]) -> str:
    """One line to print, for a known scale."""
    return f"height: {content['height_m'] * 1000:.1f} mm +- {content['height_deviation_m'] * 1000:.1f} mm, from {content['scale_source']}"
