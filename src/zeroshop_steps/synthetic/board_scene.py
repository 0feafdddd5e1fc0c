"""Virtual scenes with a printed board: beside the object in its views, or alone in a few photos of the empty scene.

`--view object` is the scene su_h with the board (height/board.py) on the surface beside the object: su_b. `--view empty` takes
photos of the same surface with the board and without the object, from elsewhere: they belong to the views of su_h, which show
no board. Both are for measuring how well a height is found.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.boards.board_files import BOARDS
from zeroshop_steps.geometry.boards.printed_board import Board, draw_board
from zeroshop_steps.geometry.cameras.pinhole import Camera, make_transform, write_cameras
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at, make_intrinsics
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.files import atomic_directory, write_json
from zeroshop_steps.synthetic import raycast, virtual_capture
from zeroshop_steps.synthetic.rendering.renderer import SceneRenderer, expose
from zeroshop_steps.synthetic.rendering.shading import use_threads
from zeroshop_steps.synthetic.scenes.camera_rings import LENS_MM, SENSOR_WIDTH_MM, ObjectBounds
from zeroshop_steps.synthetic.scenes.scene_meshes import SCENES, SURFACE_SIDE_IN_SIZES, make_object_mesh, make_surface_mesh

CACHED = Cached(inputs=("model",), ignored=("threads",))
VIEWS = ("object", "empty")
SCENE = "su_h"
BOARD = BOARDS["a4"]
GAP_MM = 5.0  # between the object and the board's squares; paper is left white around them
WHITE, BLACK = 226, 26  # of the print, sRGB
EMPTY_VIEWS = 6  # photos of the empty scene
LEAST_DISTANCE_MM = 550.0  # to have the board in the photo


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--model", type=Path, required=True, help="textured PLY in mm, upright, z up")
    parser.add_argument("--view", choices=VIEWS, required=True, help="the object beside the board, or the empty scene with the board")
    virtual_capture.add_image_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write; for the empty scene it has images and truth only")


def run(args: argparse.Namespace) -> None:
    """Entry point of the command line."""
    use_threads(args.threads)
    if args.view == "object":
        facts = {"scene": "su_b", "board": BOARD.name}
        raycast.capture(args.model, SCENE, args.width, args.height, args.seed, args.out, paint_board_beside, facts)
    else:
        capture_empty(args.model, args.width, args.height, args.seed, args.out)


def paint_board_beside(mesh: Mesh, bounds: ObjectBounds) -> Callable[[np.ndarray], None]:
    """What paints the board beside the object onto the surface's texture."""
    return lambda texture: paint_board(texture, BOARD, compute_surface_from_board(mesh, bounds, BOARD), bounds)


def capture_empty(model: Path, width_px: int, height_px: int, seed: int, out: Path) -> None:
    """Photograph the surface with the board, where the object would stand beside it.

    Raises:
        StepError: as `virtual_capture.render_capture` does.
    """
    mesh, bounds, _ = virtual_capture.read_object(model, width_px, height_px, seed)
    surface = make_surface_mesh(SCENE, bounds, seed, paint_board_beside(mesh, bounds))
    assert surface is not None, "this scene has a surface"
    renderer = SceneRenderer([make_object_mesh(_make_hidden_object(bounds)), surface], bounds, seed)
    cameras = place_empty_cameras(mesh, bounds, width_px, height_px)
    with atomic_directory(out) as folder:
        for number, camera in enumerate(cameras):
            picture = renderer.render(camera)
            write_image(folder / "images" / camera.name, expose(picture.linear, np.random.default_rng([seed, number, len(SCENES)])))
        write_cameras(folder / "truth", cameras)
        write_json(folder / "capture.json", {"scene": "empty", "virtual": True, "seed": seed, "images": len(cameras), "board": BOARD.name})


def place_empty_cameras(
    mesh: Mesh, bounds: ObjectBounds, width_px: int, height_px: int, lens_mm: float = LENS_MM, gap_mm: float = GAP_MM
) -> tuple[Camera, ...]:
    """Cameras around the middle between the object's place and the board, in the model's frame."""
    middle = (compute_surface_from_board(mesh, bounds, BOARD, gap_mm) @ np.array([BOARD.size_mm[0] / 2, BOARD.size_mm[1] / 2, 0.0, 1.0]))[
        :3
    ]
    target = (middle + [bounds.centre_mm[0], bounds.centre_mm[1], bounds.bottom_mm]) / 2
    focal_px = width_px * lens_mm / SENSOR_WIDTH_MM
    intrinsics = make_intrinsics(focal_px, width_px, height_px)
    cameras = []
    for view in range(EMPTY_VIEWS):
        azimuth = np.radians(bounds.front_azimuth_deg + 360.0 * view / EMPTY_VIEWS + 17.0)
        elevation = np.radians((35.0, 52.0)[view % 2])
        direction = direction_at(azimuth, elevation)
        pose = look_at(target + max(bounds.distance_mm, LEAST_DISTANCE_MM) * direction, target)
        cameras.append(Camera(f"{view:06d}.png", width_px, height_px, intrinsics, pose))
    return tuple(cameras)


def compute_surface_from_board(mesh: Mesh, bounds: ObjectBounds, board: Board, gap_mm: float = GAP_MM) -> np.ndarray:
    """(4, 4) model frame from the board's (x right, y down, as print is read from above): a long side faces the object, `gap_mm` away."""
    azimuth = np.radians(118.0 + bounds.front_azimuth_deg)
    outwards = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    along = np.array([-outwards[1], outwards[0], 0.0])
    foot = np.array([bounds.centre_mm[0], bounds.centre_mm[1], bounds.bottom_mm])
    reach = float(((mesh.vertices - foot) @ outwards).max()) + gap_mm
    return make_transform(
        np.stack([outwards, -along, np.cross(outwards, -along)], 1), foot + reach * outwards + along * board.size_mm[1] / 2
    )


def paint_board(texture: np.ndarray, board: Board, surface_from_board: np.ndarray, bounds: ObjectBounds) -> None:
    """Paint the board onto the (T, T, 3) uint8 texture of the surface, edges as shares of a texel."""
    texels = len(texture)
    side_mm = SURFACE_SIDE_IN_SIZES * bounds.largest_mm
    fine = max(8.0, 4.0 * texels / side_mm)  # picture elements a mm
    picture = draw_board(board, fine, GAP_MM)
    # Texture columns and rows (v points up) of picture elements, both counted from edges.
    to_texel = texels / side_mm
    low = bounds.centre_mm[:2] - side_mm / 2
    board_from_picture = np.array([[1 / fine, 0, -GAP_MM], [0, 1 / fine, -GAP_MM], [0, 0, 1]])
    plane_from_board = surface_from_board[np.ix_([0, 1, 3], [0, 1, 3])]
    texel_from_plane = np.array([[to_texel, 0, -low[0] * to_texel], [0, -to_texel, texels + low[1] * to_texel], [0, 0, 1]])
    texel_from_picture = texel_from_plane @ plane_from_board @ board_from_picture
    share = fine / to_texel
    layer = np.dstack([picture, np.ones_like(picture)])
    layer = cv2.GaussianBlur(np.pad(layer, ((8, 8), (8, 8), (0, 0))), (0, 0), 0.35 * share)  # about what a texel takes in
    shift = np.array([[1, 0, -8.0], [0, 1, -8.0], [0, 0, 1]])
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])  # OpenCV counts from centres
    warp = (np.linalg.inv(half) @ texel_from_picture @ shift @ half)[:2]
    warped = cv2.warpAffine(layer.astype(np.float32), warp, (texels, texels), flags=cv2.INTER_LINEAR)
    tone = BLACK + (WHITE - BLACK) * np.clip(warped[..., 0] / np.maximum(warped[..., 1], 1e-6), 0.0, 1.0)
    painted = texture * (1.0 - warped[..., 1:]) + tone[..., None] * warped[..., 1:]
    texture[:] = np.clip(np.rint(painted), 0, 255).astype(np.uint8)


def _make_hidden_object(bounds: ObjectBounds) -> Mesh:
    """A small tetrahedron under the surface: the renderer wants an object, the empty scene has none."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + [*bounds.centre_mm[:2], bounds.bottom_mm - 50.0]
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    return Mesh(vertices, faces, None, np.full((4, 2), 0.5), np.full((8, 8, 3), 128, np.uint8))
