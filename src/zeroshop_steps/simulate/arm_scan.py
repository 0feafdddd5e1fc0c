"""Scan a model with a simulated arm: MuJoCo moves it, a camera beside its gripper takes photos and depth, as a capture with cameras.

`next_best` goes where most surface is not measured yet, until that is enough; `ring` and `two_rings` go around at fixed elevations. Writes
images/, depth/ and cameras.json, which `zeroshop FOLDER` makes a mesh of, and scan.json: what each view added, against the true model.
"""

import argparse
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.geometry.alignment.surface_distance import SHARE_SAMPLES, sample_surface
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.geometry.observation.visibility import GRAZING_COSINE
from zeroshop_steps.grasp.gripper import GRIPPERS, find_gripper
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.scan.arm.kinematics import ARMS, find_arm
from zeroshop_steps.scan.next_views import Advice
from zeroshop_steps.scan.recorder import ScanRecorder
from zeroshop_steps.scan.session import Scan
from zeroshop_steps.scan.setup import check_least_views, make_map
from zeroshop_steps.simulate.arm.scan_robot import RINGS_DEG, ScanRobot, Stop
from zeroshop_steps.simulate.arm.scan_scene import PROJECTOR_M, ScanScene
from zeroshop_steps.synthetic.rendering.shading import use_threads

LEAST_SEEN = 3
"""Viewpoints that must see a point for it to count: what fewer of about 190 see, in a gap or behind an edge, is measured by luck."""
MEASURED_M = 0.003  # a pixel whose depth is nearer to a point's than this has measured it
OFF_SURFACE_M = 0.0002  # that rays end before a point, so that its own face does not hide it
NEXT_BEST = "next_best"
DISTANCES_M = {"ur5e": 0.40, "ur10e": 0.60}
"""From the base to the object, from where these arms reach nearly all sides of a hand-sized thing."""


class TrueSurface:
    """Points of the true surface.

    Args:
        scene: the model on its table.
        viewpoints: all cameras that can be reached, in the world.
        seed: of the samples.
    """

    def __init__(self, scene: ScanScene, viewpoints: Iterable[Camera], seed: int = 0) -> None:
        mesh = Mesh(scene.points_m, scene.mesh.faces)
        self._points, faces, _ = sample_surface(mesh, SHARE_SAMPLES, np.random.default_rng(seed))
        self._normals = mesh.face_normals()[faces]
        self._scene = scene
        counts = np.zeros(len(self._points), int)
        for camera in viewpoints:
            counts += self.sees(camera)
        # What is nearer to the table than depth is exact cannot be told from it.
        self.measurable = (counts >= LEAST_SEEN) & (self._points[:, 2] > MEASURED_M)

    def sees(self, camera: Camera) -> np.ndarray:
        """(P,) bool: the points that the sensor can measure from a camera, by its own rules and without its noise."""
        _, _, _, inside = camera.find_pixels(self._points)
        rays = camera.centre_in_world - self._points
        cosine = (self._normals * rays).sum(1) / np.linalg.norm(rays, axis=1)
        seen = np.flatnonzero(inside & (cosine > GRAZING_COSINE))
        projector = camera.centre_in_world + camera.camera_from_world[:3, :3].T @ PROJECTOR_M
        for eye in (camera.centre_in_world, projector):
            seen = seen[~self._are_hidden_from(eye, seen)]
        answer = np.zeros(len(self._points), bool)
        answer[seen] = True
        return answer

    def measured(self, camera: Camera, depth_m: np.ndarray) -> np.ndarray:
        """(P,) bool: the points that a (height, width) depth image of a camera measured."""
        rows, columns, depth, inside = camera.find_pixels(self._points)
        found = np.zeros(len(self._points), bool)
        found[inside] = np.abs(depth_m[rows[inside], columns[inside]] - depth[inside]) < MEASURED_M
        return found

    def share(self, measured: np.ndarray) -> float:
        """Completeness, 0..1, by (P,) bool."""
        return float(measured[self.measurable].mean())

    def _are_hidden_from(self, eye_m: np.ndarray, rows: np.ndarray) -> np.ndarray:
        ends = self._points[rows] + OFF_SURFACE_M * self._normals[rows]
        starts = np.broadcast_to(eye_m, ends.shape)
        rays = MM_PER_M * np.concatenate([starts - self._scene.world_from_model_m, ends - starts], 1)
        return np.asarray(self._scene.rays.test_occlusions(o3d.core.Tensor(rays.astype(np.float32)), 0.0, 1.0).numpy())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--model", type=Path, required=True, help="textured model.ply in mm, upright, z up")
    parser.add_argument("--policy", choices=[NEXT_BEST, *RINGS_DEG], default=NEXT_BEST, help="(default: %(default)s)")
    parser.add_argument("--views", type=int, default=30, help="most views, or those of the rings (default: %(default)s)")
    parser.add_argument("--least-views", type=int, default=3, help="views wanted of each part of the surface (default: %(default)s)")
    parser.add_argument("--without-depth", action="store_true", help="record no depth, and plan by the box around the object alone")
    parser.add_argument("--arm", choices=list(ARMS), default="ur10e", help="(default: %(default)s)")
    parser.add_argument("--gripper", choices=list(GRIPPERS), default="hsr", help="(default: %(default)s)")
    parser.add_argument("--distance-m", type=float, help="from the arm's base to the object (default: 0.6, ur5e: 0.4)")
    parser.add_argument("--width", type=int, default=1000, help="of the images in px (default: %(default)s)")
    parser.add_argument("--height", type=int, default=750, help="of the images in px (default: %(default)s)")
    parser.add_argument("--position-deviation", type=float, default=0.0005, help="of the poses, metres (default: %(default)s)")
    parser.add_argument("--rotation-deviation", type=float, default=0.05, help="of the poses, degrees (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the table and of all noise (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=0, help="threads for shading (default: all)")
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write; next_best continues one that was begun")


def run(args: argparse.Namespace) -> None:
    """Scan, and say what came of it."""
    _check(args)
    use_threads(args.threads)
    scene = ScanScene(read_ply(args.model), args.model, args.distance_m or DISTANCES_M[args.arm], args.seed)
    deviations = (args.position_deviation, args.rotation_deviation)
    robot = ScanRobot(find_arm(args.arm), find_gripper(args.gripper), scene, args.width, args.height, *deviations, args.seed)
    surface = make_map(scene.box, args.least_views, args.without_depth, PROJECTOR_M)
    source = f"simulated {args.arm} with a camera on its hand"
    scan = Scan(ScanRecorder(args.out, source, *(deviation or None for deviation in deviations)), surface, robot.sphere)
    if scan.views and args.policy != NEXT_BEST:
        raise StepError(f"{args.out} holds a scan that was begun; only {NEXT_BEST} continues one: name a new folder")
    true = TrueSurface(scene, map(robot.sphere.camera_at, robot.reachable_views()), args.seed)
    lens = Lens.pinhole(robot.sphere.camera.intrinsics, (args.width, args.height))
    measured, rows = np.zeros(len(true.measurable), bool), []
    for view in scan.views:
        depth_m = scan.recorder.read_depth_m(view)
        if depth_m is not None:
            measured |= true.measured(robot.sphere.camera_at(view.world_from_camera), depth_m)
    for stop in drive(robot, scan, args.policy, args.views):
        rng = np.random.default_rng([args.seed, len(scan.views)])
        depth_m = scene.depth_m(stop.camera, rng)
        view = scan.record(scene.photo(stop.camera, rng), None if args.without_depth else depth_m, lens, stop.world_from_camera)
        measured |= true.measured(stop.camera, depth_m)
        share = true.share(measured)
        rows.append({"view": view.name, "completeness": round(share, 4), "touched": stop.touched})
        print(f"{view.name}: {share:.1%} of the surface within reach", file=sys.stderr)
    advice = scan.propose(robot.reach)
    facts = {"arm": args.arm, "policy": args.policy, "enough": advice.enough, "reason": advice.reason, "views": rows}
    write_json(args.out / "scan.json", facts)
    print(f"{args.out}: {len(scan.views)} views; {advice.reason}", file=sys.stderr)


def drive(robot: ScanRobot, scan: Scan, policy: str, views: int) -> Iterator[Stop]:
    """The stops of a policy; whoever takes them records each before the next."""
    if policy != NEXT_BEST:
        yield from robot.drive_ring(views, RINGS_DEG[policy])
        return
    while len(scan.views) < views and (stop := go_on(robot, scan.propose(robot.reach))) is not None:
        yield stop


def go_on(robot: ScanRobot, advice: Advice) -> Stop | None:
    """Drive to the best proposal; None where it is enough, or none is left."""
    return None if advice.enough or not advice.proposals else robot.go(advice.proposals[0].move)


def _check(args: argparse.Namespace) -> None:
    if not 1 <= args.views <= 500:
        raise StepError(f"--views is {args.views}; expected 1 to 500")
    check_least_views(args.least_views)
    if not (64 <= args.width <= 8000 and 48 <= args.height <= 6000):
        raise StepError(f"image size {args.width} x {args.height} px is out of range; give --width 64..8000 and --height 48..6000")
    if args.distance_m is not None and not 0.2 <= args.distance_m <= 2.0:
        raise StepError(f"--distance-m is {args.distance_m:g}; expected 0.2 to 2 metres from the arm's base to the object")
    if min(args.position_deviation, args.rotation_deviation, args.seed) < 0:
        raise StepError("--position-deviation, --rotation-deviation and --seed must not be negative")
