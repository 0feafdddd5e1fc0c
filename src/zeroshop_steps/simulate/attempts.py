"""The thesis's grasp protocol (4.4.3) with one object: eight poses, in each a first attempt and, where it fails, a second one.

The robot looks, detects the object that it is asked for among those that it knows, estimates its pose, takes the best grasp for which
the table leaves room, and lifts. It knows the meshes of --models alone; MuJoCo moves the true body, which is what the camera sees.
A second attempt starts where the first one left the object, or from the same pose if it was knocked out of reach. Writes a row an
attempt, and a picture of each that failed.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import read_scene, write_scene
from zeroshop_steps.bop.formats.models import model_path
from zeroshop_steps.finish.closing.underside import close_underside
from zeroshop_steps.geometry.imaging.images import compute_overlap, write_image
from zeroshop_steps.geometry.meshes.mass_properties import count_open_edges
from zeroshop_steps.geometry.meshes.metric_mesh import MetricMesh, read_metric_mesh
from zeroshop_steps.geometry.meshes.surface_fields import weld
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.grasp.antipodal import HOLLOW_TEXT, FoundGrasps, GraspOptions, find_grasps
from zeroshop_steps.grasp.gripper import GRIPPERS, Gripper, find_gripper
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import atomic_directory, scratch_directory
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.runtime.tables import write_table
from zeroshop_steps.simulate.camera import in_memory
from zeroshop_steps.simulate.dynamics.lifting import SUCCESS, Lift, lift
from zeroshop_steps.simulate.dynamics.physics import USUAL
from zeroshop_steps.simulate.failure_pictures import draw_failure
from zeroshop_steps.simulate.perception import Perception
from zeroshop_steps.simulate.protocol import ProtocolPose
from zeroshop_steps.simulate.protocol_images import FirstLook, photograph_rest, read_first_looks
from zeroshop_steps.simulate.robot import Plan, Robot
from zeroshop_steps.simulate.true_object import SEGMENTED_IOU, TrueObject, in_mm, read_true_object
from zeroshop_steps.synthetic.rendering.shading import use_threads

READS_FAILURES = True
COLUMNS = (
    "friction", "pose", "placement", "turn_deg", "attempt", "result", "segmented", "iou", "detection_score", "pose_confidence",
    "pose_error_mm", "pose_error_diameters", "grasp_score", "opening_mm", "slip_mm",
)  # fmt: skip
ATTEMPTS = 2
REACH_M = 0.15  # an object farther from the middle of the table than this, or below its top, is put back
UNKNOWN = "no_mesh"  # the result where the robot has no mesh of the object, because its reconstruction failed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--model", type=Path, required=True, help="folder of the true model")
    parser.add_argument("--body", type=Path, required=True, help="its physical body, made by --method physical_model")
    parser.add_argument("--images", type=Path, required=True, help="its first images, made by --method protocol_images")
    parser.add_argument("--models", type=Path, required=True, help="folder of the models that the robot knows, in BOP's layout")
    parser.add_argument("--templates", type=Path, required=True, help="their 42 views")
    parser.add_argument("--aligned", type=Path, help="aligned.json of the robot's mesh, by which the error of a pose is measured")
    parser.add_argument("--gripper", choices=list(GRIPPERS), default="hsr", help="(default: %(default)s)")
    parser.add_argument("--friction", type=float, nargs="+", default=[USUAL.friction], help="coefficients, each tried (default: 0.5)")
    parser.add_argument("--seed", type=int, default=0, help="seed of lights, noise and grasps (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default: all)")
    parser.add_argument("--out", type=Path, required=True, help="folder to write: attempts.csv, and failures with their pictures")


def run(args: argparse.Namespace) -> None:
    """Write the attempts with one object."""
    use_threads(args.threads)
    perception = Perception(args.models, args.templates)
    true = read_true_object(args.model, args.body, None if args.aligned is None or read_failure(args.aligned) else args.aligned)
    looks = read_first_looks(args.images)
    rows: list[dict[str, Any]] = []
    with atomic_directory(args.out) as folder:
        if true.object_id in perception.models:
            gripper = find_gripper(args.gripper)
            known = grasps_of_model(args.models, true.object_id, gripper, GraspOptions(seed=args.seed))
            trial = Trial(true, Robot(perception, true.object_id, known, gripper), args.seed, folder / "failures")
            rows = [row for look in track(looks, "poses", len(looks)) for row in trial.try_pose(look, args.friction)]
        else:
            warn(f"{args.models} has no mesh of {args.model}: all attempts count as failed")
            rows = [describe(look.pose, 1, friction, UNKNOWN) for look in looks for friction in args.friction]
        write_table(folder / "attempts.csv", rows, COLUMNS)
    done = sum(row["result"] == SUCCESS for row in rows)
    print(f"{args.out}: {done} of {len(looks) * len(args.friction)} lifted, {len(rows)} attempts", file=sys.stderr)


@dataclass(frozen=True)
class Seen:
    """One image, what the robot plans by it, and how right that is.

    Attributes:
        look, plan: as they are.
        measures: `iou` and `pose_error_mm`, those that there are.
    """

    look: FirstLook
    plan: Plan
    measures: dict[str, float]


@dataclass(frozen=True)
class Trial:
    """One object and one robot.

    Attributes:
        true: the object.
        robot: that is asked for it.
        seed: of lights and noise.
        pictures: folder for those of failures.
    """

    true: TrueObject
    robot: Robot
    seed: int
    pictures: Path

    def try_pose(self, first: FirstLook, frictions: Sequence[float]) -> list[dict[str, Any]]:
        """The rows of one pose; the first image is the same with each friction."""
        rows, pose = [], first.pose
        planned = self._plan(first)
        for friction in frictions:
            seen = planned
            for attempt in range(1, ATTEMPTS + 1):
                lifted = self._lift(seen, friction)
                result = lifted.result if lifted else str(seen.plan.result)
                rows.append(self._describe(pose, attempt, friction, result, seen, lifted))
                if result == SUCCESS:
                    break
                name = f"friction_{friction:g}_pose_{pose.number}_{pose.placement}_attempt_{attempt}_{result}.png"
                place = seen.look.pose.world_from_object
                write_image(self.pictures / name, draw_failure(self.true, self.robot, seen.look.frame, seen.plan, place, lifted))
                if attempt < ATTEMPTS:
                    seen = self._plan(self._look_again(pose, _put_back(lifted, pose.world_from_object), attempt + 1))
        return rows

    def _look_again(self, pose: ProtocolPose, world_from_object: np.ndarray, attempt: int) -> FirstLook:
        """Take another image, of the object where it now lies."""
        with scratch_directory(self.pictures.parent / "attempts.csv", "images") as folder:
            scene = folder / f"{self.true.object_id:06d}"
            seed = [self.seed, self.true.object_id, pose.number, attempt]
            write_scene(scene, [photograph_rest(scene, self.true, world_from_object, seed, pose.number)])
            frame = read_scene(scene)[pose.number]
            return FirstLook(replace(pose, world_from_object=world_from_object), in_memory(frame), frame.mask(0))

    def _plan(self, look: FirstLook) -> Seen:
        plan = self.robot.plan(look.frame)
        measures = {}
        if plan.sighting:
            measures["iou"] = compute_overlap(look.visible, plan.sighting.mask)
            if plan.sighting.camera_from_model is not None:
                camera_from_model = look.frame.camera_from_table @ in_mm(look.pose.world_from_object)
                measures["pose_error_mm"] = self.true.pose_error_mm(plan.sighting.camera_from_model, camera_from_model)
        return Seen(look, plan, measures)

    def _lift(self, seen: Seen, friction: float) -> Lift | None:
        grasp = seen.plan.grasp
        if grasp is None:
            return None
        physics, place = replace(USUAL, friction=friction), seen.look.pose.world_from_object
        return lift(self.true.body, place, self.robot.gripper, grasp.world_from_gripper, grasp.opening_m, physics)

    def _describe(self, pose: ProtocolPose, attempt: int, friction: float, result: str, seen: Seen, lifted: Lift | None) -> dict[str, Any]:
        row = describe(pose, attempt, friction, result)
        plan, measures = seen.plan, seen.measures
        if plan.sighting:
            row["segmented"] = int(measures["iou"] >= SEGMENTED_IOU)
            row |= {"iou": measures["iou"], "detection_score": plan.sighting.score, "pose_confidence": plan.sighting.confidence}
        if "pose_error_mm" in measures:
            error_mm = measures["pose_error_mm"]
            row |= {"pose_error_mm": error_mm, "pose_error_diameters": error_mm / self.true.diameter_mm}
        if plan.grasp:
            row |= {"grasp_score": plan.grasp.score, "opening_mm": 1000.0 * plan.grasp.opening_m}
        if lifted and result == SUCCESS:
            row["slip_mm"] = lifted.slip_mm
        return {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}


def describe(pose: ProtocolPose, attempt: int, friction: float, result: str) -> dict[str, Any]:
    """The columns that every row has."""
    place = {"pose": pose.number, "placement": pose.placement, "turn_deg": round(pose.turn_deg)}
    return {"friction": friction, **place, "attempt": attempt, "result": result, "segmented": 0}


def _put_back(lifted: Lift | None, start: np.ndarray) -> np.ndarray:
    """Where the object lies before the next attempt."""
    if lifted is None:
        return start
    left = lifted.world_from_object
    return left if np.linalg.norm(left[:2, 3]) < REACH_M and left[2, 3] > 0.0 else start


def grasps_of_model(models: Path, object_id: int, gripper: Gripper, options: GraspOptions) -> FoundGrasps:
    """The grasps of one model of a folder; none, with a warning, where there is none.

    An open underside is closed first, as `finish` does it: grasps need a body. What was added is unseen and not grasped.
    """
    path = model_path(models, object_id)
    metric = read_metric_mesh(path)
    if count_open_edges(metric.mesh):
        closed = close_below(metric.mesh)
        metric = MetricMesh(closed, metric.scale, metric.scale_source, metric.relative_deviation)
    try:
        found = find_grasps(metric, gripper, options, str(path))
    except StepError as error:
        warn(f"{path} cannot be grasped: {error}")
        return FoundGrasps([], [], metric.mesh.vertices, options.friction)
    print(f"{path}: {len(found.grasps)} grasps{', ' + HOLLOW_TEXT if found.hollow else ''}", file=sys.stderr)
    return found


def close_below(mesh: Mesh) -> Mesh:
    """A mesh that stands upright, its underside closed; the faces that were added have quality 0, all others 1."""
    joined, _ = weld(mesh)
    closed, _ = close_underside(joined, np.array([0.0, 0.0, 1.0]), float(joined.vertices[:, 2].min()))
    quality = np.zeros(len(closed.vertices))
    quality[: len(joined.vertices)] = 1.0
    return Mesh(closed.vertices, closed.faces, quality=quality)
