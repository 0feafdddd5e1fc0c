"""Antipodal grasps of a parallel gripper on the measured surface of an object.

Pairs of contacts are found by rays through the surface. Around each, the gripper comes from several directions; grasps in which the
open gripper would touch the object on its way, or the table in every stable placement, are dropped. The others are ranked by how far
the closing direction lies inside both friction cones, how well that holds when the fingers come down beside, how much of the pads
touches, and how near the centre of mass is. What photos did not measure is not grasped, but it is avoided.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.meshes.mass_properties import measure_solid
from zeroshop_steps.geometry.meshes.metric_mesh import MetricMesh, add_mesh_arguments, read_metric_mesh
from zeroshop_steps.geometry.observation.support_classes import with_surface_support
from zeroshop_steps.geometry.support.placements import Placement, placements_of_hull
from zeroshop_steps.grasp.clearance import check_object, check_table
from zeroshop_steps.grasp.contacts import ContactPairs, find_contact_pairs, find_rim_pairs
from zeroshop_steps.grasp.grasps import Grasp, write_grasps
from zeroshop_steps.grasp.gripper import GRIPPERS, Gripper, find_gripper
from zeroshop_steps.grasp.ranking import APPROACHES, Candidates, balance_of, choose_spread, combine, fit_of, make_candidates
from zeroshop_steps.grasp.surface import make_grasp_surface
from zeroshop_steps.runtime.errors import StepError, warn

OPENED_BESIDE_M = 0.015  # beyond the contact on each side, what the gripper is opened by before it comes, where it can
LEAST_BESIDE_M = 0.004  # and at least; and by which contacts are shifted to see whether a grasp is robust: a pose is no better known
SHALLOWEST_M = 0.005  # of a contact from the fingertips
OBJECT_MARGIN_M, TABLE_MARGIN_M = 0.002, 0.004
MOST_PAIRS = 1200  # of contacts that the gripper is tried at, from all directions; the best ones
LEAST_ROBUSTNESS = 0.5
WALL_M, RIM_REACH_M = 0.005, 0.015  # of a wall whose inner side nobody saw: its thickness, a guess, and how far from the lid it is taken
HOLLOW_TEXT = "its grasps are at the rim, and hold only if what is assumed to be a lid is none"


@dataclass(frozen=True)
class GraspOptions:
    """What grasps are searched with.

    Attributes:
        count: how many are kept, at most.
        samples: first contacts that are tried.
        friction: coefficient between pad and object.
        seed: of the samples.
    """

    count: int = 200
    samples: int = 3000
    friction: float = 0.5
    seed: int = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_mesh_arguments(parser)
    parser.add_argument("--evidence", type=Path, help="evidence.npz of the cell's mesh: what of it was measured")
    parser.add_argument("--gripper", choices=list(GRIPPERS), default="hsr", help="the gripper that grasps are for")
    parser.add_argument("--count", type=int, default=200, help="how many grasps are kept, at most")
    parser.add_argument("--samples", type=int, default=3000, help="places on the surface that are tried as contacts")
    parser.add_argument("--friction", type=float, default=0.5, help="coefficient of friction between pads and object")
    parser.add_argument("--seed", type=int, default=0, help="seed of the samples")
    parser.add_argument("--out", type=Path, required=True, help="grasps.json; the array is written beside it, .npy")


def run(args: argparse.Namespace) -> None:
    """Find the grasps of one object."""
    metric = read_metric_mesh(args.mesh, args.unknown_scale)
    if args.evidence:
        metric = MetricMesh(with_surface_support(metric.mesh, args.evidence), metric.scale, metric.scale_source, metric.relative_deviation)
    gripper = find_gripper(args.gripper)
    options = GraspOptions(args.count, args.samples, args.friction, args.seed)
    found = find_grasps(metric, gripper, options, str(args.mesh))
    grasps = found.grasps
    write_grasps(args.out, grasps, describe(metric, gripper, options, found))
    if found.hollow:
        warn(f"measured surface of {args.mesh} has no grasp for {gripper.name}: {HOLLOW_TEXT}")
    if len(grasps) < args.count:
        warn(f"{args.mesh} has {len(grasps)} grasps for {gripper.name}; {args.count} were asked for")
    print(f"grasp: {len(grasps)} of {gripper.name}, scores {grasps[0].score:.2f} to {grasps[-1].score:.2f}", file=sys.stderr)


@dataclass(frozen=True)
class FoundGrasps:
    """What a hand needs to know of an object, metres, its frame.

    Attributes:
        grasps: the best first.
        placements: the stable ones, which the grasps refer to.
        points: (P, 3) spread over the surface that a hand must keep clear of.
        friction: coefficient that they were found with.
        hollow: whether the grasps hold only if surface that is assumed is a lid over a hollow.
    """

    grasps: list[Grasp]
    placements: list[Placement]
    points: np.ndarray
    friction: float
    hollow: bool = False


def find_grasps(metric: MetricMesh, gripper: Gripper, options: GraspOptions, name: str) -> FoundGrasps:
    """The grasps of a closed mesh.

    Where measured surface has none, as a plain bowl whose hollow nothing shows, its rim is grasped: a wall is assumed there, and a hollow
    behind it. If there is none, the hand meets the lid on its approach.

    Args:
        name: of the mesh's file, for messages.

    Raises:
        StepError: the mesh is open, nothing of it was measured, or nothing of it fits the gripper.
    """
    mesh, rng = metric.mesh, np.random.default_rng(options.seed)
    centre = measure_solid(mesh, name).centre
    placements = placements_of_hull(mesh.vertices, centre)
    surface = make_grasp_surface(mesh, rng)
    if not surface.measured.any():
        raise StepError(
            f"nothing of {name} was measured, and grasps are found on measured surface alone; take a surface method that measures (2dgs)"
        )
    shift_m = max(LEAST_BESIDE_M, metric.relative_deviation * float(np.ptp(mesh.vertices, axis=0).max()))
    pairs = find_contact_pairs(surface, options.samples, largest_width(gripper), options.friction, shift_m, rng)
    pairs = pairs.at(pairs.robustness >= LEAST_ROBUSTNESS)
    found = _grasps_at(pairs, centre, placements, surface.points, gripper, options.count)
    if found:
        return FoundGrasps(found, placements, surface.points, options.friction)
    points = surface.points[~surface.assumed]
    rim = find_rim_pairs(surface, WALL_M, RIM_REACH_M, options.samples, rng)
    found = _grasps_at(rim, centre, placements, points, gripper, options.count)
    if not found:
        raise StepError(
            f"{name} has no grasp for {gripper.name}: {len(pairs.width)} pairs of contacts were found that are at most"
            f" {1000 * largest_width(gripper):.0f} mm apart, and the open gripper has no room at any."
            " Take a gripper that opens wider, or check the mesh's size"
        )
    return FoundGrasps(found, placements, points, options.friction, True)


def _grasps_at(
    pairs: ContactPairs, centre: np.ndarray, placements: Sequence[Placement], points: np.ndarray, gripper: Gripper, count: int
) -> list[Grasp]:
    """The grasps at some of the pairs, at most `count`, the best first; empty where the gripper has no room at any."""
    # Without their balance: the pairs nearest to the centre of mass may all lie where no hand gets.
    best = np.argsort(-combine({"friction": pairs.friction, "robustness": pairs.robustness}), kind="stable")
    pairs = pairs.at(best[:MOST_PAIRS])
    candidates, above = _above_table(pairs, placements, gripper)
    if not len(above):
        return []
    poses, widths = candidates.object_from_gripper, pairs.width[candidates.pair]
    pads = check_object(points, poses, widths, opening_for(widths, gripper), gripper, OBJECT_MARGIN_M)
    measures = {
        "friction": pairs.friction[candidates.pair],
        "robustness": pairs.robustness[candidates.pair],
        "balance": balance_of(pairs, centre)[candidates.pair],
        "fit": fit_of(pads.excess_m),
        "touching": pads.touching,
    }
    free = np.flatnonzero(pads.free)
    scores = combine(measures)
    reach = np.einsum("nd,nd->n", pairs.middle[candidates.pair] - poses[:, :3, 3], poses[:, :3, 2])
    chosen = free[choose_spread(poses[free], gripper.tcp_m, scores[free], count, above[free])]
    return [
        Grasp(
            poses[number], float(widths[number]), float(reach[number]), float(scores[number]),
            tuple(int(place) for place in np.flatnonzero(above[number])),
            {key: float(values[number]) for key, values in measures.items()},
        )
        for number in chosen
    ]  # fmt: skip


def largest_width(gripper: Gripper) -> float:
    """Between contacts that the gripper can take, m."""
    return gripper.max_opening_m - 2 * LEAST_BESIDE_M


def opening_for(widths_m: np.ndarray, gripper: Gripper) -> np.ndarray:
    """(N,) between the pads on the approach to (N,) contacts so far apart."""
    return np.minimum(widths_m + 2 * OPENED_BESIDE_M, gripper.max_opening_m)


def _above_table(pairs: ContactPairs, placements: Sequence[Placement], gripper: Gripper) -> tuple[Candidates, np.ndarray]:
    """The candidates that keep clear of the table in a placement, and (N, S) bool, in which of S.

    Where the fingertips would reach below a thin object, the gripper stays back, so that the contacts are near the tips.
    """
    openings = np.tile(opening_for(pairs.width, gripper), APPROACHES)
    deep = make_candidates(pairs, gripper)
    shallow = make_candidates(pairs, gripper, gripper.pad_length_m / 2 - SHALLOWEST_M)
    above = check_table(placements, deep.object_from_gripper, openings, gripper, TABLE_MARGIN_M)
    beyond = check_table(placements, shallow.object_from_gripper, openings, gripper, TABLE_MARGIN_M) & ~above
    kept, added = np.flatnonzero(above.any(1)), np.flatnonzero(beyond.any(1))
    poses = np.concatenate([deep.object_from_gripper[kept], shallow.object_from_gripper[added]])
    return Candidates(poses, np.concatenate([deep.pair[kept], shallow.pair[added]])), np.concatenate([above[kept], beyond[added]])


def describe(metric: MetricMesh, gripper: Gripper, options: GraspOptions, found: FoundGrasps) -> dict[str, Any]:
    """What the JSON says beside the grasps."""
    return {
        "gripper": {
            "name": gripper.name,
            "max_opening_m": gripper.max_opening_m,
            "tcp_m": round(gripper.tcp_m, 6),
            "finger_length_m": gripper.finger_length_m,
        },
        "scale": metric.scale,
        "scale_source": metric.scale_source,
        "friction": options.friction,
        "seed": options.seed,
        "hollow_assumed": found.hollow,
        "placements": [
            {
                "kind": placement.kind,
                "probability": round(placement.probability, 5),
                "stability_deg": round(placement.stability_deg, 2),
                "plane_from_object": [round(float(value), 7) for value in placement.plane_from_object.reshape(-1)],
            }
            for placement in found.placements
        ],
    }
