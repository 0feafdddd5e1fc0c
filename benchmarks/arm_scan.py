"""Views that a simulated arm needs until 98 % of the surface within its reach is measured: by proposals, and around fixed rings.

`python benchmarks/arm_scan.py --models FOLDER --objects 3 5 8 --out OUT` for a folder in BOP's layout; `--demo mug bowl` for demo objects.
Of a ring, the smallest number of evenly spaced views that is enough is sought; what the arm does not reach is left out and not counted.
Writes views.csv, curves.csv and views.png.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.grasp.gripper import find_gripper
from zeroshop_steps.runtime.files import read_json_value, scratch_directory
from zeroshop_steps.runtime.tables import write_table
from zeroshop_steps.scan.arm.kinematics import ARMS, find_arm
from zeroshop_steps.scan.measured_surface import MeasuredSurface
from zeroshop_steps.scan.next_views import propose
from zeroshop_steps.simulate.arm.scan_robot import RINGS_DEG, ScanRobot
from zeroshop_steps.simulate.arm.scan_scene import PROJECTOR_M, ScanScene
from zeroshop_steps.simulate.arm_scan import DISTANCES_M, NEXT_BEST, TrueSurface, go_on
from zeroshop_steps.synthetic.demo_objects import write_demo_object

WANTED = 0.98
MOST_VIEWS = 40
RING_VIEWS = (3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 24, 28, 32, 36, 40)
WIDTH_PX, HEIGHT_PX = 320, 240
COLUMNS = ("object", "policy", "views", "completeness_then", "views_when_enough", "completeness_when_enough", "touched", "seconds")


def main() -> None:
    """Measure all objects, and print and draw what they need."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=Path, help="folder of models in BOP's layout")
    parser.add_argument("--objects", type=int, nargs="*", default=[], help="their numbers")
    parser.add_argument("--demo", nargs="*", default=[], help="names of demo objects")
    parser.add_argument("--arm", choices=list(ARMS), default="ur10e")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows, curves = [], []
    for name, model in find_models(args):
        found, points = measure_object(name, model, args.arm, args.seed)
        rows += found
        curves += points
        for row in found:
            print(*(row[column] for column in COLUMNS), flush=True)
    write_table(args.out / "views.csv", rows, COLUMNS)
    write_table(args.out / "curves.csv", curves, ("object", "policy", "views", "completeness"))
    draw(rows, curves, args.out / "views.png")


def find_models(args: argparse.Namespace) -> list[tuple[str, object]]:
    """Names and meshes."""
    found = []
    if args.objects:
        info = read_json_value(args.models / "models_info.json")
        for number in args.objects:
            path = args.models / f"obj_{number:06d}.ply"
            found.append((info[str(number)].get("name", path.stem), (path, read_ply(path))))
    for name in args.demo:
        with scratch_directory(args.out / "views.csv", name) as folder:
            write_demo_object(name, folder)
            found.append((f"demo {name}", (folder / "model.ply", read_ply(folder / "model.ply"))))
    return found


def measure_object(name: str, model: tuple, arm: str, seed: int) -> tuple[list[dict], list[dict]]:
    """Rows of `views.csv` and of `curves.csv`."""
    path, mesh = model
    scene = ScanScene(mesh, path, DISTANCES_M[arm], seed)
    start = ScanRobot(find_arm(arm), find_gripper("hsr"), scene, WIDTH_PX, HEIGHT_PX)
    viewpoints = start.reachable_views()
    true = TrueSurface(scene, map(start.sphere.camera_at, viewpoints), seed)
    possible = len(start.sphere.place(scene.box))
    print(
        f"# {name}: {len(viewpoints)} of {possible} viewpoints reached, {true.measurable.mean():.1%} of the surface measurable", flush=True
    )
    rows, curves = [], []
    for policy in (NEXT_BEST, *RINGS_DEG):
        begun_s = time.monotonic()
        run = scan_by_proposals if policy == NEXT_BEST else scan_by_rings
        shares, end, touched = run(scene, true, arm, seed, policy)
        curves += [{"object": name, "policy": policy, "views": views, "completeness": round(share, 4)} for views, share in shares]
        reached = next(((views, share) for views, share in shares if share >= WANTED), None)
        row = {"object": name, "policy": policy, "touched": touched, "seconds": round(time.monotonic() - begun_s, 1)}
        row |= {"views": reached[0] if reached else f">{max(views for views, _ in shares)}"}
        row |= {"completeness_then": round(reached[1] if reached else max(share for _, share in shares), 4)}
        row |= {"views_when_enough": end[0] if end else "", "completeness_when_enough": round(end[1], 4) if end else ""}
        rows.append(row)
    return rows, curves


def scan_by_proposals(scene: ScanScene, true: TrueSurface, arm: str, seed: int, policy: str) -> tuple[list, tuple | None, bool]:
    """(views, completeness) after each view, the same where the planner said that it is enough, and whether anything was touched."""
    robot = ScanRobot(find_arm(arm), find_gripper("hsr"), scene, WIDTH_PX, HEIGHT_PX)
    surface = MeasuredSurface(scene.box, 1, second_eye_m=PROJECTOR_M)
    measured, taken, shares, touched = np.zeros(len(true.measurable), bool), [], [], False
    while len(taken) < MOST_VIEWS:
        stop = go_on(robot, propose(surface, robot.sphere, robot.reach, taken))
        if stop is None:
            return shares, shares[-1], touched
        depth_m = scene.depth_m(stop.camera, np.random.default_rng([seed, len(taken)]))
        surface.add_view(stop.camera, depth_m)
        measured |= true.measured(stop.camera, depth_m)
        taken.append(stop.world_from_camera)
        shares.append((len(taken), true.share(measured)))
        touched |= stop.touched
    return shares, None, touched


def scan_by_rings(scene: ScanScene, true: TrueSurface, arm: str, seed: int, policy: str) -> tuple[list, None, bool]:
    """The same of rings: a scan of its own for each number of views, until one is complete."""
    shares, touched = [], False
    for count in RING_VIEWS:
        if count % len(RINGS_DEG[policy]):
            continue
        robot = ScanRobot(find_arm(arm), find_gripper("hsr"), scene, WIDTH_PX, HEIGHT_PX)
        measured, taken = np.zeros(len(true.measurable), bool), 0
        for stop in robot.drive_ring(count, RINGS_DEG[policy]):
            depth_m = scene.depth_m(stop.camera, np.random.default_rng([seed, taken]))
            measured |= true.measured(stop.camera, depth_m)
            taken, touched = taken + 1, touched | stop.touched
        shares.append((taken, true.share(measured)))
        if shares[-1][1] >= WANTED:
            break
    return shares, None, touched


def draw(rows: list[dict], curves: list[dict], path: Path) -> None:
    """Completeness by views, a panel an object."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(dict.fromkeys(row["object"] for row in rows))
    columns = 4
    lines = -(-len(names) // columns)
    figure, axes = pyplot.subplots(lines, columns, figsize=(11, 2.5 * lines), sharex=True, sharey=True, squeeze=False)
    labels = {NEXT_BEST: "proposals", "ring": "ring at 35°", "two_rings": "rings at 20° and 55°"}
    for axis in axes.flat[len(names) :]:
        axis.axis("off")
    for name, axis in zip(names, axes.flat, strict=False):
        for policy, label in labels.items():
            points = [(one["views"], one["completeness"]) for one in curves if (one["object"], one["policy"]) == (name, policy)]
            axis.plot(*zip(*points, strict=True), marker=".", label=label)
        axis.axhline(WANTED, color="0.6", linewidth=0.8, linestyle="--")
        axis.set(title=name, xlim=(0, 25), ylim=(0.6, 1.005))
    for axis in axes[-1]:
        axis.set_xlabel("views")
    axes[0, 0].set_ylabel("completeness")
    axes[0, 0].legend(fontsize=8, loc="lower right")
    figure.tight_layout()
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    sys.exit(main())
