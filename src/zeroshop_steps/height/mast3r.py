"""Measure the scale by a network that has learned metric sizes: it aligns two photos of the object and four of the empty scene.

Leroy et al., MASt3R, ECCV 2024. As in the thesis, photos of the empty scene are added because the network misjudges close views
alone; without any, more photos of the object take their place. The height itself is measured on the mesh, above the support plane.
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pycolmap
import torch

from zeroshop_steps.geometry.alignment.robust_estimates import MEDIAN_POINTS
from zeroshop_steps.geometry.cameras.registered_views import View, space_evenly
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.geometry.imaging.images import list_images
from zeroshop_steps.height.record import RegisteredObject, Scale, add_common_arguments, write_height
from zeroshop_steps.networks.devices import DEVICES, choose_device
from zeroshop_steps.networks.mast3r.framing import LONG_SIDE_PX, Framing
from zeroshop_steps.networks.mast3r.global_alignment import Alignment, align_images
from zeroshop_steps.networks.mast3r.inference import NAME, Mast3rPredictor, PairPredictor
from zeroshop_steps.networks.mast3r.model import SIZES, load_mast3r
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, resolve_weights
from zeroshop_steps.register.mast3r import Mast3rOptions
from zeroshop_steps.runtime.errors import StepError

OBJECT_VIEWS, SCENE_VIEWS = 2, 4  # as in the thesis
APART_DEG = 36.0  # angle between the photos of the object: neighbours in the thesis's rings of ten
NETWORK_DEVIATION = 0.08
"""Relative standard deviation of the network's sizes: the root mean square error of published heights (thesis, Tables 4.3 and 4.4)."""

METHOD = {
    "title": "MASt3R",
    "rank": 3,
    "columns": ("marker_images",),
    "weights": ("MASt3R_ViTLarge_BaseDecoder_512_catmlpdpt_metric.pth",),
    "mem_mb": 6000,
    "runtime_min": 120,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    parser.add_argument("--marker-images", type=Path, help="folder of photos of the empty scene; a board in them is not needed")
    parser.add_argument(
        "--long-side-px",
        type=int,
        default=LONG_SIDE_PX,
        help="length of the network's pictures along the longer side (default: %(default)s)",
    )
    parser.add_argument("--blind", action="store_true", help="do not compare with the known height: for tables of the error")
    parser.add_argument("--device", choices=DEVICES, default="auto", help="where the network runs (default: %(default)s)")
    parser.add_argument("--weights", type=Path, default=WEIGHTS_FOLDER / NAME, help="the network's weights (default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Write height.json."""
    device = torch.device(choose_device(args.device))
    weights = resolve_weights(args.weights, NAME, SIZES)
    scene = _take_evenly(list_images(args.marker_images), SCENE_VIEWS) if args.marker_images else []

    def predictor(paths: Sequence[Path]) -> PairPredictor:
        return Mast3rPredictor(load_mast3r(weights), paths, device, args.long_side_px)

    measure = partial(measure_scale, scene_photos=scene, predictor=predictor)
    write_height(args, "mast3r", measure, None if args.blind else "the network takes the object for another one of another size")


def measure_scale(
    registered: RegisteredObject, scene_photos: Sequence[Path], predictor: Callable[[Sequence[Path]], PairPredictor]
) -> Scale:
    """The scale that the network gives: its depths over the registration's, at the registration's points.

    Args:
        registered: what is measured.
        scene_photos: of the empty scene.
        predictor: gives the network for photos.

    Raises:
        StepError: photos match none of the others, or the registration has too few points in them.
    """
    chosen = choose_object_views(registered.views, OBJECT_VIEWS if scene_photos else OBJECT_VIEWS + SCENE_VIEWS)
    prepared = predictor([view.image_path for view in chosen] + list(scene_photos))
    torch.manual_seed(0)
    alignment = align_images(prepared, Mast3rOptions().min_confidence)
    model = read_reconstruction(registered.cameras / "sparse")
    ratios = [
        compute_depth_ratios(model, view, prepared.framings[number], alignment.depth_m[number], alignment.confidence[number])
        for number, view in enumerate(chosen)
    ]
    points = sum(map(len, ratios))
    if points < MEDIAN_POINTS:
        raise StepError(
            f"the registration has {points} points in the photos that the network looked at, {MEDIAN_POINTS} are needed to compare sizes;"
            " give the height as height_m, or measure it with a printed board"
        )
    medians = np.array([np.median(np.log(ratio)) for ratio in ratios if len(ratio)])
    scale = float(np.exp(medians.mean()))
    disagreement = float(np.std(medians)) / np.sqrt(len(medians))
    deviation = float(np.linalg.norm([NETWORK_DEVIATION, disagreement, alignment.scale_deviation]))
    evidence = {
        "object_photos": [view.camera.name for view in chosen],
        "scene_photos": [path.name for path in scene_photos],
        "points": points,
        "error_px": round(alignment.error_px, 3),
        "photos_disagree_share": round(disagreement, 5),
        "pairs_disagree_share": round(alignment.scale_deviation, 5),
        "metres_per_unit_by_camera_distance": compute_baseline_ratio(alignment, chosen),
    }
    return Scale("mast3r", scale, deviation, evidence)


def choose_object_views(views: Sequence[View], count: int) -> list[View]:
    """Choose `count` views: the first, then each time the one whose angle to the nearest chosen one is closest to `APART_DEG`."""
    axes = np.stack([view.camera.camera_from_world[2, :3] for view in views])
    angles = np.degrees(np.arccos(np.clip(axes @ axes.T, -1.0, 1.0)))
    taken = [0]
    while len(taken) < min(count, len(views)):
        off = np.abs(angles[:, taken].min(1) - APART_DEG)
        off[taken] = np.inf
        taken.append(int(np.argmin(off)))
    return [views[number] for number in taken]


def compute_depth_ratios(
    model: pycolmap.Reconstruction, view: View, framing: Framing, depth_m: np.ndarray, confidence: np.ndarray
) -> np.ndarray:
    """(P,) metres per unit of the registration, at its points in this photo of which the network is confident."""
    image = next(image for image in model.images.values() if image.name == view.camera.name)
    seen = [point for point in image.points2D if point.has_point3D()]
    pixels = np.array([point.xy for point in seen]).reshape(-1, 2)
    _, depth = view.camera.project(np.array([model.points3D[point.point3D_id].xyz for point in seen]).reshape(-1, 3))
    place = np.floor(framing.from_original(pixels)).astype(int)
    inside = (place >= 0).all(1) & (place < [framing.width_px, framing.height_px]).all(1) & (depth > 0)
    rows, columns = place[inside, 1], place[inside, 0]
    found = depth_m[rows, columns]
    trusted = (confidence[rows, columns] >= np.median(confidence)) & (found > 0)
    return found[trusted] / depth[inside][trusted]


def compute_baseline_ratio(alignment: Alignment, views: Sequence[View]) -> float:
    """Metres per unit from the distance between the first two cameras: less exact, for comparison."""
    found = np.linalg.norm(alignment.world_from_camera[1, :3, 3] - alignment.world_from_camera[0, :3, 3])
    return float(found / np.linalg.norm(views[1].camera.centre_in_world - views[0].camera.centre_in_world))


def _take_evenly(paths: list[Path], count: int) -> list[Path]:
    """`count` of the paths, evenly from the first to the last."""
    return [paths[number] for number in space_evenly(len(paths), count)]
