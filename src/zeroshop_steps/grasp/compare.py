"""Judge grasps that somebody gave, such as hand-made ones, by the checks that ours pass, and say how near the nearest of ours is.

The gripper is opened, moved to each grasp and closed. A grasp is refused where it `misses` (a finger meets nothing), is `too_wide`,
`slips` (the closing axis lies outside a friction cone) or `collides` (the open gripper touches the object on its way).
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.meshes.metric_mesh import add_mesh_arguments, read_metric_mesh
from zeroshop_steps.grasp.antipodal import LEAST_BESIDE_M, OBJECT_MARGIN_M, OPENED_BESIDE_M
from zeroshop_steps.grasp.clearance import check_object
from zeroshop_steps.grasp.grasps import read_grasp_array, read_grasps
from zeroshop_steps.grasp.gripper import GRIPPERS, Gripper, find_gripper
from zeroshop_steps.grasp.surface import GraspSurface, make_grasp_surface
from zeroshop_steps.runtime.tables import write_table

PAD_GRID = 5  # rays along each side of a pad; the one that meets the object first is the contact


@dataclass(frozen=True)
class Verdicts:
    """How N grasps do.

    Attributes:
        reasons: (N,) text: `accepted`, `misses`, `too_wide`, `slips` or `collides`, the first that holds.
        widths_m: (N,) between the contacts, NaN where a finger meets nothing.
        slip_deg: (N,) the larger angle between the closing axis and a contact's normal, NaN likewise.
    """

    reasons: np.ndarray
    widths_m: np.ndarray
    slip_deg: np.ndarray


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_mesh_arguments(parser)
    parser.add_argument("--given", type=Path, required=True, help="the grasps to judge: .npy of (N, 1, 16), metres, object frame")
    parser.add_argument("--grasps", type=Path, required=True, help="ours: grasps.json of the same object in the same frame")
    parser.add_argument("--gripper", choices=list(GRIPPERS), default="hsr", help="the gripper that both are for")
    parser.add_argument("--friction", type=float, default=0.5, help="coefficient of friction between pads and object")
    parser.add_argument("--out", type=Path, required=True, help="CSV with a row for each given grasp")


def run(args: argparse.Namespace) -> None:
    """Judge the grasps of one file."""
    metric, gripper = read_metric_mesh(args.mesh, args.unknown_scale), find_gripper(args.gripper)
    given, ours = read_grasp_array(args.given), read_grasps(args.grasps)
    surface = make_grasp_surface(metric.mesh, np.random.default_rng(0))
    verdicts = judge(surface, given, gripper, args.friction)
    own = np.array([grasp.object_from_gripper for grasp in ours])
    distance, approach, closing = find_nearest(given, own, gripper)
    rows = [
        {
            "grasp": number,
            "verdict": verdicts.reasons[number],
            "width_mm": _round(1000 * verdicts.widths_m[number]),
            "slip_deg": _round(verdicts.slip_deg[number]),
            "nearest_mm": _round(1000 * distance[number]),
            "nearest_approach_deg": _round(approach[number]),
            "nearest_closing_deg": _round(closing[number]),
        }
        for number in range(len(given))
    ]
    write_table(args.out, rows)
    accepted = int((verdicts.reasons == "accepted").sum())
    print(f"compare: {accepted} of {len(given)} given grasps are accepted; nearest of ours {np.median(1000 * distance):.0f} mm (median)",
          file=sys.stderr)  # fmt: skip


def judge(surface: GraspSurface, object_from_gripper: np.ndarray, gripper: Gripper, friction: float) -> Verdicts:
    """Close the gripper at (N, 4, 4) poses, metres."""
    reach = gripper.max_opening_m / 2
    x = np.linspace(-1, 1, PAD_GRID) * gripper.finger_width_m / 2
    z = gripper.tcp_m + np.linspace(-1, 1, PAD_GRID) * gripper.pad_length_m / 2
    grid = np.stack(np.meshgrid(x, z, indexing="ij"), -1).reshape(-1, 2)
    count, rays = len(object_from_gripper), len(grid)
    turns, places = object_from_gripper[:, :3, :3], object_from_gripper[:, :3, 3]
    contacts, slips = [], []
    for side in (1.0, -1.0):
        starts = np.column_stack([grid[:, 0], np.full(rays, side * reach), grid[:, 1]])
        origins = np.einsum("nij,rj->nri", turns, starts) + places[:, None]
        directions = np.repeat(-side * turns[:, None, :, 1], rays, 1)
        travelled, facing = surface.cast(origins.reshape(-1, 3), directions.reshape(-1, 3))
        travelled = travelled.reshape(count, rays)
        first = travelled.argmin(1)
        nearest = travelled[np.arange(count), first]
        met = nearest < reach + gripper.max_opening_m / 2
        hit = origins[np.arange(count), first] + np.where(met, nearest, 0.0)[:, None] * directions[:, 0]
        normals, _ = surface.smooth_normals_at(hit, facing.reshape(count, rays, 3)[np.arange(count), first])
        slip = np.degrees(np.arccos(np.clip(-np.einsum("nd,nd->n", normals, directions[:, 0]), -1, 1)))
        contacts.append(np.where(met, side * (reach - nearest), np.nan))
        slips.append(np.where(met, slip, np.nan))
    widths, slip = contacts[0] - contacts[1], np.maximum(*slips)
    missed = ~np.isfinite(widths) | (widths <= 0)
    known = np.where(missed, 0.0, widths)
    opening = np.minimum(known + 2 * OPENED_BESIDE_M, gripper.max_opening_m)
    free = check_object(surface.points, object_from_gripper, known, opening, gripper, OBJECT_MARGIN_M).free
    wide = known > gripper.max_opening_m - 2 * LEAST_BESIDE_M
    loose = np.where(missed, 90.0, slip) > np.degrees(np.arctan(friction))
    reasons = np.select([missed, wide, loose, ~free], ["misses", "too_wide", "slips", "collides"], "accepted")
    return Verdicts(reasons, np.where(missed, np.nan, widths), np.where(missed, np.nan, slip))


def find_nearest(given: np.ndarray, ours: np.ndarray, gripper: Gripper) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each given grasp to the nearest of ours: (N,) metres between the tool centre points, (N,) degrees between the approaches and
    (N,) between the closing axes. Nearest is the least sum of both distances, with 30 degrees for 20 mm.

    Args:
        given: (N, 4, 4) metres.
        ours: (M, 4, 4) metres.
    """
    tcp = [poses[:, :3, 3] + gripper.tcp_m * poses[:, :3, 2] for poses in (given, ours)]
    distance = np.linalg.norm(tcp[0][:, None] - tcp[1][None], axis=2)
    approach = np.degrees(np.arccos(np.clip(given[:, :3, 2] @ ours[:, :3, 2].T, -1, 1)))
    closing = np.degrees(np.arccos(np.clip(np.abs(given[:, :3, 1] @ ours[:, :3, 1].T), 0, 1)))
    best = (distance / 0.02 + (approach + closing) / 30).argmin(1)
    index = np.arange(len(given))
    return distance[index, best], approach[index, best], closing[index, best]


def _round(value: float) -> float | None:
    """One decimal; None where there is no value."""
    return round(float(value), 1) if np.isfinite(value) else None
