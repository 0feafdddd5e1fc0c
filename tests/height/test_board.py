"""The printed board: its size on paper, and what cameras make of it."""

import re
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.boards.board_files import BOARDS
from zeroshop_steps.geometry.boards.printed_board import MM_PER_INCH, Board, draw_board, draw_sheet
from zeroshop_steps.geometry.cameras.viewpoints import look_at
from zeroshop_steps.height.board_corners import check_board_views, detect_board, detect_corners, identify_board
from zeroshop_steps.height.board_fit import fit_board
from zeroshop_steps.height.board_view import BoardView
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError

A4 = BOARDS["a4"]


@pytest.mark.parametrize(
    "board", [pytest.param(board, id=name, marks=[] if name == "a4" else pytest.mark.slow) for name, board in BOARDS.items()]
)
def test_the_sheet_shows_the_board_at_its_size(board):
    """Printed at 8 dots a millimetre and read back, every corner is where the board says, in millimetres."""
    figure = draw_sheet(board)
    figure.set_dpi(8 * MM_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    page = np.asarray(canvas.buffer_rgba())[:, :, :3]
    assert page.shape[:2] == pytest.approx((board.paper_mm[1] * 8, board.paper_mm[0] * 8), abs=2)
    numbers, pixels = detect_corners(np.ascontiguousarray(page), board)
    assert len(numbers) == (board.columns - 1) * (board.rows - 1)
    offset = pixels / 8 - board.corners_mm()[numbers, :2]
    assert np.abs(offset - offset.mean(0)).max() < 0.1
    assert offset.mean(0)[0] == pytest.approx((board.paper_mm[0] - board.size_mm[0]) / 2, abs=0.1), "in the middle of the paper"
    assert identify_board(page) == board.name


@pytest.mark.slow
def test_the_pdf_is_a_vector_drawing_of_exact_size(tmp_path):
    out = tmp_path / "board.pdf"
    assert stage_main("zeroshop_steps.height", ["--method", "print_board", "--out", str(out)]) == 0
    data = out.read_bytes()
    box = [float(value) for value in re.search(rb"/MediaBox \[([^\]]*)\]", data)[1].split()]
    assert [box[2] / 72 * MM_PER_INCH, box[3] / 72 * MM_PER_INCH] == pytest.approx([210.0, 297.0], abs=0.01)
    streams = []
    for match in re.finditer(rb"stream\r?\n", data):
        try:
            streams.append(zlib.decompressobj().decompress(data[match.end() :]))
        except zlib.error:
            continue
    drawing = max(streams, key=lambda stream: stream.count(b" l\n"))
    numbers = rb"(-?[\d.]+) (-?[\d.]+)"
    lines = re.findall(numbers + rb" m\n" + numbers + rb" l\n+S", drawing)
    lengths_mm = [abs(float(b[0]) - float(a[0])) / 72 * MM_PER_INCH for a, b in ((line[:2], line[2:]) for line in lines)]
    assert max(lengths_mm) == pytest.approx(150.0, abs=0.01), "the ruler line"
    squares = re.findall(numbers + rb" m\n" + numbers + rb" l\n" + numbers + rb" l\n" + numbers + rb" l\nh", drawing)
    sides_mm = np.array([float(square[2]) - float(square[0]) for square in squares[1:]]) / 72 * MM_PER_INCH  # the first is the page
    assert (np.abs(sides_mm - 25.0) < 1e-3).sum() == 35
    assert b"/Subtype /Image" not in data
    again = tmp_path / "again.pdf"
    assert stage_main("zeroshop_steps.height", ["--method", "print_board", "--out", str(again)]) == 0
    assert again.read_bytes() == data


def test_a_board_is_only_written_as_pdf(tmp_path, capsys):
    assert stage_main("zeroshop_steps.height", ["--method", "print_board", "--out", str(tmp_path / "board.png")]) == 1
    assert ".pdf" in capsys.readouterr().err


def cameras(count: int, seed: int = 0, distance_mm: float = 500.0) -> list[np.ndarray]:
    """(4, 4) camera_from_world of cameras around the board's middle, which lies in the plane z = 0 of a world in mm, z up."""
    rng = np.random.default_rng(seed)
    middle = np.array([*A4.size_mm, 0.0]) / 2
    poses = []
    for k in range(count):
        azimuth, elevation = 2 * np.pi * k / count + rng.uniform(0, 0.3), np.radians(rng.uniform(35, 75))
        direction = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
        poses.append(look_at(middle + distance_mm * np.array(direction), middle))
    return poses


FOCAL_PX, SIZE_PX = 900.0, (640, 480)
K = np.array([[FOCAL_PX, 0.0, SIZE_PX[0] / 2], [0.0, FOCAL_PX, SIZE_PX[1] / 2], [0.0, 0.0, 1.0]])


def to_rays(pixels: np.ndarray) -> np.ndarray:
    return (pixels - K[:2, 2]) / FOCAL_PX


def photo(pose: np.ndarray, board: Board = A4, shape=(1.0, 1.0)) -> np.ndarray:
    """(480, 640, 3) picture of a board on grey; its x and y stretched by `shape`, its y turned so that it faces up."""
    texels = 4.0
    picture = np.repeat((40 + 180 * draw_board(board, texels, 10.0))[..., None], 3, -1).astype(np.uint8)
    world_from_texel = np.array(
        [[shape[0] / texels, 0, -10 * shape[0]], [0, -shape[1] / texels, board.size_mm[1] + 10 * shape[1]], [0, 0, 1]]
    )
    homography = K @ pose[:3, [0, 1, 3]] @ world_from_texel
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])  # OpenCV counts pixel centres, everyone else edges
    return cv2.warpPerspective(picture, np.linalg.inv(half) @ homography @ half, SIZE_PX, flags=cv2.INTER_AREA, borderValue=(128, 128, 128))


def views_of(poses: list[np.ndarray], scale: float = 1.0, turn: np.ndarray | None = None, **how) -> list[BoardView]:
    """What photos show, their cameras in a registration of another scale and orientation."""
    turn = np.eye(3) if turn is None else turn
    found = []
    for number, pose in enumerate(poses):
        moved = pose.copy()
        moved[:3, :3] = pose[:3, :3] @ turn.T
        moved[:3, 3] *= scale
        found.append(detect_board(f"{number}", photo(pose, **how), A4, to_rays, moved, FOCAL_PX))
    return [view for view in found if view]


@pytest.fixture(scope="module")
def six_views():
    return views_of(cameras(6))


def test_corners_are_read_to_a_fraction_of_a_pixel(six_views):
    assert len(six_views) == 6
    for view in six_views:
        corners = A4.corners_mm()[view.numbers]
        world = np.c_[corners[:, 0], A4.size_mm[1] - corners[:, 1], np.zeros(len(corners))]
        points = world @ view.camera_from_world[:3, :3].T + view.camera_from_world[:3, 3]
        error_px = np.linalg.norm(points[:, :2] / points[:, 2:] - view.rays, axis=1) * FOCAL_PX
        assert np.median(error_px) < 0.25
        assert view.square_px == pytest.approx(25.0 * FOCAL_PX / 500.0, rel=0.4)


@given(log_scale=st.floats(-7, 3), rotation=st.tuples(*[st.floats(-1, 1) for _ in range(4)]).filter(lambda q: np.linalg.norm(q) > 0.1))
@settings(max_examples=6, deadline=None)
def test_the_scale_is_found_in_any_registration(six_views, log_scale, rotation):
    scale, turn = np.exp(log_scale), Rotation.from_quat(rotation).as_matrix()
    moved = []
    for view in six_views:
        pose = view.camera_from_world.copy()
        pose[:3, :3] = pose[:3, :3] @ turn.T
        pose[:3, 3] *= scale
        moved.append(replace(view, camera_from_world=pose))
    fit = fit_board(A4, moved)
    assert fit.units_per_mm == pytest.approx(scale, rel=1e-3)
    assert fit.deviation < 1e-3 and fit.residual_px < 0.5 and fit.corners == 54 and fit.photos == 6
    assert fit.stretch == pytest.approx(1.0, abs=2e-3)


def test_the_deviation_tells_of_wrong_cameras(six_views):
    rng = np.random.default_rng(1)
    scales, deviations = [], []
    for _ in range(8):
        shaken = []
        for view in six_views:
            pose = view.camera_from_world.copy()
            pose[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.002, 3)).as_matrix() @ pose[:3, :3]
            pose[:3, 3] += rng.normal(0, 1.0, 3)
            shaken.append(replace(view, camera_from_world=pose))
        fit = fit_board(A4, shaken)
        scales.append(fit.units_per_mm - 1.0)
        deviations.append(fit.deviation)
    actual, told = np.sqrt(np.mean(np.square(scales))), np.median(deviations)
    assert 0.3 < told / actual < 4.0


def test_mistaken_corners_do_not_count(six_views):
    wrong = [replace(view, rays=view.rays + (np.arange(len(view.rays)) % 9 == 0)[:, None] * 0.05) for view in six_views]
    assert fit_board(A4, wrong).units_per_mm == pytest.approx(1.0, rel=3e-3)


def test_a_stretched_print_is_refused():
    with pytest.raises(StepError, match="out of shape.*another size"):
        fit_board(A4, views_of(cameras(4), shape=(1.0, 0.95)))


def test_a_board_that_moved_is_refused(six_views):
    half = [replace(view, rays=view.rays + 0.06 * (k % 2)) for k, view in enumerate(six_views)]
    with pytest.raises(StepError, match="moved between the photos"):
        fit_board(A4, half)


def test_views_from_one_place_are_refused(six_views):
    with pytest.raises(StepError, match="nearly one place"):
        fit_board(A4, [six_views[0], replace(six_views[0], name="again")])


def test_photos_of_nothing_of_another_board_of_too_little_of_it_are_refused(six_views):
    blank = np.full((480, 640, 3), 90, np.uint8)
    with pytest.raises(StepError, match="the 1 photos show no board a4.*too small"):
        check_board_views([], A4, [blank], "the 1 photos")
    with pytest.raises(StepError, match="show the board a3, not a4"):
        check_board_views([], A4, [photo(cameras(1, distance_mm=700.0)[0], BOARDS["a3"])], "the 1 photos")
    few = [replace(view, numbers=view.numbers[:5], rays=view.rays[:5]) for view in six_views]
    with pytest.raises(StepError, match="cut off or hidden"):
        check_board_views(few, A4, [], "the 6 photos")
    with pytest.raises(StepError, match="cut off or hidden: 1 of"):
        check_board_views(six_views[:1], A4, [], "the 6 photos")
    with pytest.raises(StepError, match="too small"):
        check_board_views([replace(view, square_px=7.0) for view in six_views], A4, [], "the 6 photos")


def test_a_board_far_away_is_not_read():
    assert detect_corners(photo(cameras(1, distance_mm=4000.0)[0]), A4)[0].size == 0


def test_half_a_board_is_read():
    image = photo(cameras(1)[0])
    image[:, :320] = 128
    numbers, _ = detect_corners(image, A4)
    assert 8 <= len(numbers) < 40
