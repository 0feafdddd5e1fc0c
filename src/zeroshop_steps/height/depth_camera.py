"""Measure the scale by depth images: the ratio of measured depth to the mesh's depth in the registration.

Each depth image is a 16-bit PNG of its photo's size, named like the photo and aligned with it pixel by pixel; 0 where nothing was
measured. The scale is the median ratio on the object.
"""

import argparse
import os
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.capture.cameras_json import FILE, read_given_cameras
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.image_files import check_kind
from zeroshop_steps.geometry.imaging.images import decode_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.geometry.support.ground_plane import DEVIATION_OF_MEDIAN
from zeroshop_steps.height.record import RegisteredObject, Scale, add_common_arguments, write_height
from zeroshop_steps.register.scene.record import find_lens
from zeroshop_steps.register.scene.undistortion import undistort_by_lens
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

LEAST_IMAGES = 3  # so that one bad image does not decide the median
LEAST_PIXELS = 100  # on the object, in an image
RIM_PX = 3  # at the silhouette, where depth cameras mix object and background
NEAREST_MM, FARTHEST_MM = 50.0, 5000.0  # from the object; nearer no depth camera measures, and farther nobody holds one
OFF_DIAGONALS = 0.15  # a pixel whose depth is this far off, in diagonals of the object, shows something else
MOST_OFF = 0.15  # share of such pixels from which on the images are not aligned

METHOD = {"rank": 2, "columns": ("depth",), "required": ("depth",), "original_photos": True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    parser.add_argument("--depth", type=Path, required=True, help="folder of depth images, named like the photos but .png")
    parser.add_argument(
        "--step-mm",
        type=float,
        default=1.0,
        help=f"millimetres a step of the depth images, unless {FILE} beside their folder says it (default: %(default)s)",
    )


def run(args: argparse.Namespace) -> None:
    """Write height.json."""
    if not 1e-3 <= args.step_mm <= 100.0:
        raise StepError(f"--step-mm is {args.step_mm:g}; a step of a depth image is 0.001 to 100 mm, most often 1")
    beside = args.depth.parent / FILE
    step_mm = (read_given_cameras(beside).depth_step_mm if beside.is_file() else None) or args.step_mm
    mesh = read_ply(args.mesh)
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    else_wrong = "the depth images have another unit (height.depth_camera.step_mm)"
    write_height(
        args,
        "depth_camera",
        lambda registered: measure_scale(registered, MeshRenderer(mesh), diagonal, args.depth, step_mm),
        else_wrong,
    )


def measure_scale(registered: RegisteredObject, renderer: MeshRenderer, diagonal: float, folder: Path, step_mm: float) -> Scale:
    """The scale that the depth images agree on.

    Args:
        registered: with the registered views.
        renderer: of the mesh in their frame.
        diagonal: of the mesh's box, in its unit.
        folder: of the depth images.
        step_mm: millimetres a step.

    Raises:
        StepError: too few depth images, a wrong format, size or unit, or images that are not aligned with the photos.
    """
    if not folder.is_dir():
        raise StepError(f"the folder of depth images {folder} does not exist")
    files = find_depth_files(registered, folder)
    if len(files) < LEAST_IMAGES:
        raise StepError(
            f"{folder} has depth images for {len(files)} of the {len(registered.views)} registered photos, {LEAST_IMAGES} are needed; each "
            "is named like its photo, but .png"
        )
    record_path = registered.cameras / "registration.json"
    record = read_json(record_path) if record_path.is_file() else {}
    ratios, off = {}, {}
    for view, path in files:
        lens = find_lens(record, Path(view.camera.name).stem)
        measured_mm = undistort_by_lens(read_depth(path, view), lens, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT) * step_mm
        depth = renderer.find_depth(view.camera)
        inside = cv2.erode((view.mask() & (depth > 0)).astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2), borderValue=0) > 0
        inside &= measured_mm > 0
        if inside.sum() < LEAST_PIXELS:
            continue
        ratio = float(np.median(measured_mm[inside] / depth[inside]))
        ratios[path.name] = ratio
        off[path.name] = float((np.abs(measured_mm[inside] / ratio - depth[inside]) > OFF_DIAGONALS * diagonal).mean())
        _check_unit(path, float(np.median(measured_mm[inside])), step_mm)
    if len(ratios) < LEAST_IMAGES:
        raise StepError(f"{folder}: only {len(ratios)} depth images have measured depth on the object, {LEAST_IMAGES} are needed")
    values = np.array(list(ratios.values()))
    scale_mm = float(np.median(values))
    spread = DEVIATION_OF_MEDIAN * float(np.median(np.abs(values / scale_mm - 1.0)))
    share = float(np.median(list(off.values())))
    if share > MOST_OFF or spread > OFF_DIAGONALS:
        worst = max(off, key=lambda name: off[name])
        raise StepError(
            f"{folder}: the depth images are not aligned with the photos: {share:.0%} of the object's pixels show something else "
            f"({worst}: {off[worst]:.0%}), and their scales differ by {spread:.0%}; export depth that is aligned to the colour image"
        )
    evidence = {"depth_images": len(ratios), "spread": round(spread, 5), "off_share": round(share, 5), "step_mm": step_mm}
    return Scale("depth_camera", scale_mm / 1000.0, spread / np.sqrt(len(values)), evidence)


def find_depth_files(registered: RegisteredObject, folder: Path) -> list[tuple[View, Path]]:
    """Each view's depth image, where there is one, named like the user's photo. Raises StepError for a video."""
    record = registered.capture / "capture.json"
    facts = read_json(record)
    if "source_frames" in facts:
        raise StepError(f"depth images belong to photos, and {registered.capture} comes from a video: export the colour images as photos")
    names = facts.get("source_names")
    numbers = [int(Path(view.camera.name).stem) for view in registered.views] if names else []
    if names and not (isinstance(names, list) and all(isinstance(name, str) for name in names) and max(numbers) < len(names)):
        raise StepError(f"{record}: source_names must list the user's photos, one for each image; delete the folder and run capture again")
    found = []
    for view in registered.views:
        stem = Path(view.camera.name).stem
        path = folder / f"{Path(names[int(stem)]).stem if names else stem}.png"
        if os.path.lexists(path):
            check_kind(path)
            found.append((view, path))
    return found


def read_depth(path: Path, view: View) -> np.ndarray:
    """(height, width) float32 steps. Raises StepError for an image that is no depth image, or not aligned with its photo."""
    depth = decode_image(path, cv2.IMREAD_UNCHANGED)
    if depth.ndim != 2 or depth.dtype != np.uint16:
        kind = f"{depth.dtype} with {1 if depth.ndim == 2 else depth.shape[2]} channel(s)"
        raise StepError(f"depth image {path} is {kind}; expected a 16-bit PNG with one channel, in millimetres")
    if depth.shape != (view.camera.height_px, view.camera.width_px):
        raise StepError(
            f"depth image {path} is {depth.shape[1]} x {depth.shape[0]} px, its photo {view.camera.width_px} x {view.camera.height_px} px: "
            "it is not aligned with the photo; export depth that is aligned to the colour image"
        )
    return depth.astype(np.float32)


def _check_unit(path: Path, median_mm: float, step_mm: float) -> None:
    if not NEAREST_MM <= median_mm <= FARTHEST_MM:
        raise StepError(
            f"depth image {path} puts the object {median_mm:g} mm away: it looks like another unit (metres, tenths of millimetres) than the"
            f" {step_mm:g} mm a step that are expected; export millimetres, or give the unit as height.depth_camera.step_mm"
        )
