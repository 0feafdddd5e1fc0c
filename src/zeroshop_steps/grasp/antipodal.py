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

from zeroshop_steps.geometry.metric_mesh import MetricMesh, add_mesh_arguments, read_metric_mesh
from zeroshop_steps.geometry.placements import Placement, placements_of_hull
from zeroshop_steps.geometry.solids import measure_solid
from zeroshop_steps.geometry.support_classes import with_surface_support
from zeroshop_steps.grasp.clearance import check_object, check_table
from zeroshop_steps.grasp.contacts import ContactPairs, find_contact_pairs
from zeroshop_steps.grasp.grasps import Grasp, write_grasps
from zeroshop_steps.grasp.gripper import GRIPPERS, Gripper, find_gripper
from zeroshop_steps.grasp.ranking import APPROACHES, Candidates, balance_of, choose_spread, combine, fit_of, make_candidates
from zeroshop_steps.grasp.surface import make_grasp_surface
from zeroshop_steps.runtime.errors import StepError, warn

OPENED_BESIDE_M = 0.015  # beyond the contact on each side, what the gripper is opened by before it comes, where it can
LEAST_BESIDE_M = 0.004  # and at least: a pose is no better known
SHALLOWEST_M = 0.005  # of a contact from the fingertips
OBJECT_MARGIN_M, TABLE_MARGIN_M = 0.002, 0.004
LEAST_SHIFT_M = 0.004  # by which contacts are shifted to see whether a grasp is robust; more where the height is uncertain
MOST_PAIRS = 1200  # of contacts that the gripper is tried at, from all directions; the best ones
LEAST_ROBUSTNESS = 0.5


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
    grasps, placements = find_grasps(metric, gripper, options, str(args.mesh))
    write_grasps(args.out, grasps, describe(metric, gripper, options, placements))
    if len(grasps) < args.count:
        warn(f"{args.mesh} has {len(grasps)} grasps for {gripper.name}; {args.count} were asked for")
    print(f"grasp: {len(grasps)} of {gripper.name}, scores {grasps[0].score:.2f} to {grasps[-1].score:.2f}", file=sys.stderr)


def find_grasps(metric: MetricMesh, gripper: Gripper, options: GraspOptions, name: str) -> tuple[list[Grasp], list[Placement]]:
    """The grasps of a closed mesh, the best first, and its stable placements (metres), which the grasps refer to.

    Args:
        name: of the mesh's file, for messages.

    Raises:
        StepError: the mesh is open, nothing of it was measured, or nothing of it fits the gripper.
    """
    mesh, rng = metric.mesh, np.random.default_rng(options.seed)
    solid = measure_solid(mesh, name)
    placements = placements_of_hull(mesh.vertices, solid.centre)
    surface = make_grasp_surface(mesh, rng)
    if not surface.measured.any():
        raise StepError(
            f"nothing of {name} was measured, and grasps are found on measured surface alone; take a surface method that measures (2dgs)"
        )
    largest_m = gripper.max_opening_m - 2 * LEAST_BESIDE_M
    shift_m = max(LEAST_SHIFT_M, metric.relative_deviation * float(np.ptp(mesh.vertices, axis=0).max()))
    pairs = find_contact_pairs(surface, options.samples, largest_m, options.friction, shift_m, rng)
    pairs = pairs.at(pairs.robustness >= LEAST_ROBUSTNESS)
    balance = balance_of(pairs, solid.centre)
    best = np.argsort(-combine({"friction": pairs.friction, "robustness": pairs.robustness, "balance": balance}), kind="stable")
    pairs = pairs.at(best[:MOST_PAIRS])
    candidates, above = _above_table(pairs, placements, gripper)
    _require(len(above), name, gripper, pairs)
    openings = opening_for(pairs.width, gripper)[candidates.pair]
    widths = pairs.width[candidates.pair]
    pads = check_object(surface.points, candidates.object_from_gripper, widths, openings, gripper, OBJECT_MARGIN_M)
    measures = {
        "friction": pairs.friction[candidates.pair],
        "robustness": pairs.robustness[candidates.pair],
        "balance": balance_of(pairs, solid.centre)[candidates.pair],
        "fit": fit_of(pads.excess_m),
        "touching": pads.touching,
    }
    free = np.flatnonzero(pads.free)
    _require(len(free), name, gripper, pairs)
    scores = combine(measures)
    reach = np.einsum(
        "nd,nd->n", pairs.middle[candidates.pair] - candidates.object_from_gripper[:, :3, 3], candidates.object_from_gripper[:, :3, 2]
    )
    chosen = free[choose_spread(candidates.object_from_gripper[free], gripper.tcp_m, scores[free], options.count, above[free])]
    found = [
        Grasp(
            candidates.object_from_gripper[number], float(widths[number]), float(reach[number]), float(scores[number]),
            tuple(int(place) for place in np.flatnonzero(above[number])),
            {key: float(values[number]) for key, values in measures.items()},
        )
        for number in chosen
    ]  # fmt: skip
    return found, placements


def _require(left: int, name: str, gripper: Gripper, pairs: ContactPairs) -> None:
    """Raise StepError where no candidate is left."""
    if left == 0:
        raise StepError(
            f"{name} has no grasp for {gripper.name}: {len(pairs.width)} pairs of contacts were found that are at most"
            f" {1000 * (gripper.max_opening_m - 2 * LEAST_BESIDE_M):.0f} mm apart, and the open gripper has no room at any."
            " Take a gripper that opens wider, or check the mesh's size"
        )


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


def describe(metric: MetricMesh, gripper: Gripper, options: GraspOptions, placements: Sequence[Placement]) -> dict[str, Any]:
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
        "placements": [
            {
                "kind": placement.kind,
                "probability": round(placement.probability, 5),
                "stability_deg": round(placement.stability_deg, 2),
                "plane_from_object": [round(float(value), 7) for value in placement.plane_from_object.reshape(-1)],
            }
            for placement in placements
        ],
    }
