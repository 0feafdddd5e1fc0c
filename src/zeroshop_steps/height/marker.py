"""Measure the scale by a printed board (`--method print_board` writes it), beside the object or in photos of the empty scene.

Photos of the empty scene (`--marker-images`) are first localized among the object's photos by the ground that both show, so one
set serves all objects filmed there. The board's corners, seen by at least two cameras, then tell how many millimetres a unit of
the registration is.
"""

import argparse
from functools import partial
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.boards.board_files import read_board
from zeroshop_steps.geometry.boards.printed_board import RULER_MM, Board, TagBoard
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.height.board_corners import check_board_views, detect_board
from zeroshop_steps.height.board_fit import BoardFit, fit_board
from zeroshop_steps.height.board_view import BoardView
from zeroshop_steps.height.record import RegisteredObject, Scale, add_common_arguments, write_height
from zeroshop_steps.height.scene_photos import localize_photos
from zeroshop_steps.height.tag_boards import fit_tags
from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.runtime.errors import StepError

RULER_ERROR_MM = 0.2  # of reading the ruler line's length
WRONG_PRINT = f"the board was printed at another size (measure its {RULER_MM:g} mm line and give that as height.marker.ruler_mm)"

BOARD_HELP = (
    "which board was printed: a4 or a3 (print_board), a YAML file that describes another one, or tags of one size by dictionary and side in"
    " mm, such as 36h11:50 (default: %(default)s)"
)
METHOD = {"rank": 1, "columns": ("marker_images",), "seed": True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    parser.add_argument("--marker-images", type=Path, help="folder of photos of the empty scene with the board; else it is in the object's")
    parser.add_argument("--board", default="a4", help=BOARD_HELP)
    parser.add_argument(
        "--ruler-mm",
        type=float,
        default=RULER_MM,
        help="length of the ruler line as printed; it tells the print's scale (default: %(default)s)",
    )
    parser.add_argument("--blind", action="store_true", help="do not compare with the known height: for tables of the error")
    parser.add_argument("--seed", type=int, default=0, help="seed of all RANSAC loops (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=2, help="worker threads (default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Write height.json."""
    if not 0.5 * RULER_MM <= args.ruler_mm <= 2.0 * RULER_MM:
        raise StepError(f"--ruler-mm is {args.ruler_mm:g}; the line is {RULER_MM:g} mm long, give the length in mm that was measured")
    options = SiftOptions(threads=args.threads, seed=args.seed)

    measure = partial(measure_scale, read_board(args.board), args.marker_images, args.ruler_mm / RULER_MM, options)
    write_height(args, "marker", measure, None if args.blind else WRONG_PRINT)


def measure_scale(
    board: Board | TagBoard, marker_images: Path | None, print_scale: float, options: SiftOptions, registered: RegisteredObject
) -> Scale:
    """The scale that the board gives.

    Raises:
        StepError: no board, another one, too little of it, or one that does not fit.
    """
    views = find_board_in_scene(board, marker_images, registered, options) if marker_images else find_board_beside_object(board, registered)
    fit = fit_tags(board, views) if isinstance(board, TagBoard) else fit_board(board, views)
    deviation = float(np.hypot(fit.deviation, RULER_ERROR_MM / RULER_MM))
    return Scale("marker", 0.001 * print_scale / fit.units_per_mm, deviation, _describe_evidence(board, fit, marker_images, print_scale))


def find_board_beside_object(board: Board | TagBoard, registered: RegisteredObject) -> list[BoardView]:
    """The board's corners in the object's own photos."""
    found = []
    for view in registered.views:
        k = view.camera.intrinsics
        to_rays = partial(_compute_rays, np.array([k[0, 2], k[1, 2]]), np.array([k[0, 0], k[1, 1]]))
        found.append(detect_board(view.camera.name, view.image(), board, to_rays, view.camera.camera_from_world, float(k[0, 0])))
    views = [view for view in found if view]
    check_board_views(views, board, [] if views else [view.image() for view in registered.views], f"the {len(found)} photos of the object")
    return views


def find_board_in_scene(board: Board | TagBoard, folder: Path, registered: RegisteredObject, options: SiftOptions) -> list[BoardView]:
    """The board's corners in photos of the empty scene, which are localized among the object's photos."""
    if not folder.is_dir():
        raise StepError(f"{folder} does not exist; marker_images names the folder of the photos of the empty scene")
    photos = localize_photos(folder, registered.views, options)
    images = [read_image(photo.path) for photo in photos]
    found = [
        detect_board(photo.path.name, image, board, photo.rays, photo.camera_from_world, photo.camera.mean_focal_length())
        for photo, image in zip(photos, images, strict=True)
    ]
    views = [view for view in found if view]
    check_board_views(views, board, images, f"the {len(photos)} photos in {folder} whose camera was found")
    return views


def _compute_rays(centre: np.ndarray, focal: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    return (pixels - centre) / focal


def _describe_evidence(board: Board | TagBoard, fit: BoardFit, marker_images: Path | None, print_scale: float) -> dict:
    return {
        "board": board.name,
        "board_seen_in": "photos of the empty scene" if marker_images else "the object's photos",
        "photos": fit.photos,
        "corners": fit.corners,
        "residual_px": round(fit.residual_px, 3),
        "stretch": round(fit.stretch, 5),
        "print_scale": print_scale,
    }
