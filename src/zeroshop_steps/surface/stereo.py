"""Multi-view stereo: depths that several registered images confirm, seeds made from them, and the visual hull carved by them.

Depth images that came with the photos are joined, each depth by its uncertainty.

Writes seeds.npz, from which the optimizers of this stage start unless told otherwise, and stereo.json (seconds and figures).
"""

import argparse
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.compute.kernel_devices import DEVICES, choose_kernel_device
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.mvs.noise_models import NOISE

if TYPE_CHECKING:  # they import torch and OpenCV, which takes longer than to plan
    from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
    from zeroshop_steps.geometry.observation.visual_hull import VisualHull
    from zeroshop_steps.surface.mvs.given_depth import GivenDepth
    from zeroshop_steps.surface.rendering.training_views import CameraSet, TrainingView

LATER_PASSES = (2, 3)
"""Numbers of the passes for which an object was turned over."""
CACHED = Cached(
    inputs=(
        "cameras/images",
        "cameras/masks",
        "cameras/confidence",
        "cameras/sparse",
        "depth",
        "depth/../cameras.json",
        "depth_2",
        "depth_2/../cameras.json",
        "depth_3",
        "depth_3/../cameras.json",
        "capture/capture.json",
    ),
    ignored=("threads",),
    outputs=("seeds.npz", "stereo.json"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--cameras", type=Path, required=True, help="folder of a registration: images, masks and sparse model")
    parser.add_argument("--out", type=Path, required=True, help="folder for seeds.npz and stereo.json")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--depth", type=Path, help="folder of depth images that came with the photos, named like them but .png")
    for number in LATER_PASSES:
        parser.add_argument(f"--depth-{number}", type=Path, help=f"that of pass {number}")
    parser.add_argument(
        "--depth-step-mm", type=float, default=1.0, help="millimetres a step, unless cameras.json beside the folder says it"
    )
    parser.add_argument("--depth-camera", choices=sorted(NOISE), default="structured_light", help="its kind (default: %(default)s)")
    parser.add_argument("--capture", type=Path, help="capture folder, whose capture.json has the photos' names; with --depth")
    parser.add_argument("--device", choices=DEVICES, default="cpu", help="where planes are searched (default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    from zeroshop_steps.geometry.cameras.object_crops import fit_object_sphere
    from zeroshop_steps.runtime.compute.threads import use_threads
    from zeroshop_steps.runtime.files import write_json
    from zeroshop_steps.surface.mvs.depth_consistency import find_seeds
    from zeroshop_steps.surface.mvs.seeds import carve_hull, write_seeds
    from zeroshop_steps.surface.rendering.training_views import make_grid_view, make_seed_views, read_camera_set

    threads, device = use_threads(args.threads), choose_kernel_device(args.device)
    start_s, start_cpu_s = time.monotonic(), time.process_time()
    camera_set = read_camera_set(args.cameras)
    sphere = fit_object_sphere(camera_set.model.cameras, camera_set.masks)
    views = make_seed_views(camera_set, sphere)
    grid = [make_grid_view(view) for view in views]
    hull = carve_hull(grid)
    folders = {number: getattr(args, f"depth_{number}") for number in LATER_PASSES}
    folders = {number: folder for number, folder in {1: args.depth, **folders}.items() if folder}
    given = _read_depth(args, folders, camera_set, sphere, views, hull) if folders else None
    seeds, joined = find_seeds(views, hull, args.seed, device, given)
    write_seeds(args.out / "seeds.npz", seeds, sphere)
    write_json(
        args.out / "stereo.json",
        {
            "seconds": round(time.monotonic() - start_s, 2),
            "cpu_seconds": round(time.process_time() - start_cpu_s, 2),
            "threads": threads,
            "device": device,
            "seeds": len(seeds.positions),
            "confirmed_depths": sum(int((depth > 0).sum()) for depth in seeds.depth_maps.values()),
            "hull_voxels": int(hull.occupied.sum()),
            "carved_voxels": int(hull.occupied.sum() - seeds.carved_hull.occupied.sum()),
            **({"given_depth": {"camera": args.depth_camera, **given.figures, **joined}} if given else {}),
        },
    )


def _read_depth(
    args: argparse.Namespace,
    folders: dict[int, Path],
    camera_set: "CameraSet",
    sphere: "ObjectSphere",
    views: "list[TrainingView]",
    hull: "VisualHull",
) -> "GivenDepth | None":
    """The depth images of the capture. Raises StepError where they are none, or not aligned."""
    from zeroshop_steps.geometry.cameras.registered_views import read_views
    from zeroshop_steps.register.scene.depth_folder import DepthFolder
    from zeroshop_steps.surface.mvs.given_depth import read_given_depth

    if args.capture is None:
        raise StepError("--depth needs --capture, whose capture.json has the photos' names")
    registered, _ = read_views(args.cameras)
    folder = DepthFolder.find(folders, registered, args.cameras, args.capture, args.depth_step_mm)
    return read_given_depth(folder, args.depth_camera, registered, camera_set.model, sphere, views, hull)
