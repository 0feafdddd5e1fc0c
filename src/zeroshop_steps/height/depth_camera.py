"""Measure the scale by depth images: the ratio of measured depth to the mesh's depth in the registration.

Each depth image is a 16-bit PNG of its photo's size, named like the photo and aligned with it pixel by pixel; 0 where nothing was
measured. The scale is the median ratio on the object.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.capture.cameras_json import FILE
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.height.record import RegisteredObject, Scale, add_common_arguments, write_height
from zeroshop_steps.register.photometry.view_similarity import RIM_PX
from zeroshop_steps.register.scene.depth_folder import OFF_DIAGONALS, DepthFolder
from zeroshop_steps.register.scene.image_set import MIN_IMAGES
from zeroshop_steps.runtime.errors import StepError

LEAST_PIXELS = 100  # on the object, in an image

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
    mesh = read_ply(args.mesh)
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))

    def measure(registered: RegisteredObject) -> Scale:
        depth = DepthFolder.find({1: args.depth}, registered.views, registered.cameras, registered.capture, args.step_mm)
        return measure_scale(registered, MeshRenderer(mesh), diagonal, depth)

    write_height(args, "depth_camera", measure, "the depth images have another unit (height.depth_camera.step_mm)")


def measure_scale(registered: RegisteredObject, renderer: MeshRenderer, diagonal: float, depth: DepthFolder) -> Scale:
    """The scale that the depth images agree on.

    Args:
        registered: with the registered views.
        renderer: of the mesh in their frame.
        diagonal: of the mesh's box, in its unit.
        depth: the depth images.

    Raises:
        StepError: too few depth images, a wrong format, size or unit, or images that are not aligned with the photos.
    """
    folder = depth.folder
    if len(depth.files) < MIN_IMAGES:
        raise StepError(
            f"{folder} has depth images for {len(depth.files)} of the {len(registered.views)} registered photos, {MIN_IMAGES} are needed;"
            " each is named like its photo, but .png"
        )
    ratios, off = {}, {}
    for view in registered.views:
        measured_mm = depth.read_mm(view)
        if measured_mm is None:
            continue
        found = renderer.find_depth(view.camera)
        inside = cv2.erode((view.mask() & (found > 0)).astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2), borderValue=0) > 0
        inside &= measured_mm > 0
        if inside.sum() < LEAST_PIXELS:
            continue
        ratio = float(np.median(measured_mm[inside] / found[inside]))
        ratios[view.camera.name] = ratio
        off[view.camera.name] = float((np.abs(measured_mm[inside] / ratio - found[inside]) > OFF_DIAGONALS * diagonal).mean())
        depth.check_unit(view, float(np.median(measured_mm[inside])))
    if len(ratios) < MIN_IMAGES:
        raise StepError(f"{folder}: only {len(ratios)} depth images have measured depth on the object, {MIN_IMAGES} are needed")
    scale_mm, spread, share = depth.agree(ratios, off)
    evidence = {"depth_images": len(ratios), "spread": round(spread, 5), "off_share": round(share, 5), "step_mm": depth.steps_mm[1]}
    return Scale("depth_camera", scale_mm / 1000.0, spread / np.sqrt(len(ratios)), evidence)
