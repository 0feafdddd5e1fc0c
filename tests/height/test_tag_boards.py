"""Boards that people have already give the scale: grids of tags, tags of one size, a bar, and ChArUco boards of other programs."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from zeroshop_steps.geometry.boards.board_files import BOARDS, read_board
from zeroshop_steps.geometry.boards.printed_board import Board, TagBoard
from zeroshop_steps.geometry.cameras.viewpoints import look_at
from zeroshop_steps.height.board_corners import check_board_views, detect_board
from zeroshop_steps.height.board_fit import fit_board
from zeroshop_steps.height.board_view import BoardView
from zeroshop_steps.height.tag_boards import fit_tags
from zeroshop_steps.runtime.errors import StepError

SCALE = 0.37  # units of the registration in a millimetre
FOCAL_PX, SIZE_PX, TEXELS = 900.0, (640, 480), 4
K = np.array([[FOCAL_PX, 0.0, SIZE_PX[0] / 2], [0.0, FOCAL_PX, SIZE_PX[1] / 2], [0.0, 0.0, 1.0]])
PAGE_MM = (200, 150)
TAGS = {3: (20, 20), 8: (110, 25), 11: (60, 85)}


def draw_tags(places_mm: dict[int, tuple[float, float]], side_mm: float, name: str = "APRILTAG_36h11", border: int = 1) -> np.ndarray:
    """A white page with tags, whose upper left corners are there."""
    page = np.full((PAGE_MM[1] * TEXELS, PAGE_MM[0] * TEXELS), 220, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
    for number, (x, y) in places_mm.items():
        left, top, side = round(x * TEXELS), round(y * TEXELS), round(side_mm * TEXELS)
        page[top : top + side, left : left + side] = np.clip(
            cv2.aruco.generateImageMarker(dictionary, number, side, borderBits=border), 30, 220
        )
    return page


def views_of(page: np.ndarray, board: Board | TagBoard, count: int = 5) -> list[BoardView]:
    """What photos from around a page show, their cameras in a registration of another scale."""
    middle, found = np.array([*PAGE_MM, 0.0]) / 2, []
    world_from_texel = np.array([[1 / TEXELS, 0, 0], [0, -1 / TEXELS, PAGE_MM[1]], [0, 0, 1]])
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    for k in range(count):
        direction = np.array([np.cos(1.3 * k) * 0.5, np.sin(1.3 * k) * 0.5, 0.8])
        pose = look_at(middle + 420 * direction, middle)
        homography = np.linalg.inv(half) @ K @ pose[:3, [0, 1, 3]] @ world_from_texel @ half
        photo = cv2.warpPerspective(page, homography, SIZE_PX, flags=cv2.INTER_AREA, borderValue=128)
        moved = pose.copy()
        moved[:3, 3] *= SCALE
        image = np.repeat(photo[..., None], 3, -1)
        found.append(detect_board(f"{k}", image, board, lambda pixels: (pixels - K[:2, 2]) / FOCAL_PX, moved, FOCAL_PX))
    return [view for view in found if view]


def grid_places(board: TagBoard) -> dict[int, tuple[float, float]]:
    """Where the tags of a grid are on the page."""
    return {board.first_id + k: tuple(corners[0, :2] + 15) for k, corners in enumerate(board.corners_mm().reshape(-1, 4, 3))}


def describe(folder: Path, text: str) -> str:
    path = folder / "board.yaml"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("kind: grid\ndictionary: 36h11\ncolumns: 4\nrows: 3\nmarker_mm: 30\ngap_mm: 10\nfirst_id: 5\n", "APRILTAG_36h11"),
        ("kind: grid\ndictionary: DICT_4X4_50\ncolumns: 4\nrows: 2\nmarker_mm: 30\ngap_mm: 6\n", "4X4_50"),
        ("target_type: 'aprilgrid'\ntagCols: 4\ntagRows: 3\ntagSize: 0.03\ntagSpacing: 0.3\n", "APRILTAG_36h11"),
    ],
)
def test_a_grid_gives_the_scale(tmp_path: Path, text: str, name: str) -> None:
    board = read_board(describe(tmp_path, text))
    views = views_of(draw_tags(grid_places(board), board.marker_mm, name, board.border_cells), board)
    check_board_views(views, board, [], "the photos")
    fit = fit_tags(board, views)
    assert fit.units_per_mm == pytest.approx(SCALE, rel=0.003) and fit.corners == len(board.corners_mm()) and fit.residual_px < 0.5


def test_tags_of_one_size_give_the_scale() -> None:
    board = read_board("36h11:32")
    views = views_of(draw_tags(TAGS, 32), board)
    check_board_views(views, board, [], "the photos")
    fit = fit_tags(board, views)
    assert fit.units_per_mm == pytest.approx(SCALE, rel=0.01) and 0 < fit.deviation < 0.02 and fit.corners == 12


def test_a_bar_gives_the_scale(tmp_path: Path) -> None:
    distance_mm = float(np.hypot(90, 5))
    board = read_board(describe(tmp_path, f"kind: bar\ndictionary: 36h11\nids: [3, 8]\ndistance_mm: {distance_mm}\n"))
    views = views_of(draw_tags(TAGS, 32), board)
    check_board_views(views, board, [], "the photos")
    assert fit_tags(board, views).units_per_mm == pytest.approx(SCALE, rel=0.003)
    with pytest.raises(StepError, match="no two of them both tags of the bar; show it in more photos"):
        check_board_views(views[:1], board, [], "the photos")


@pytest.mark.parametrize("legacy", [False, True])
def test_a_charuco_board_of_another_program_gives_the_scale(tmp_path: Path, legacy: bool) -> None:
    text = f"kind: charuco\ndictionary: 6x6_250\ncolumns: 8\nrows: 6\nsquare_mm: 20\nmarker_mm: 15\nlegacy: {str(legacy).lower()}\n"
    board = read_board(describe(tmp_path, text))
    made = cv2.aruco.CharucoBoard((8, 6), 20, 15, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250))
    made.setLegacyPattern(legacy)
    page = np.full((PAGE_MM[1] * TEXELS, PAGE_MM[0] * TEXELS), 220, np.uint8)
    page[60:540, 80:720] = np.clip(made.generateImage((640, 480)), 30, 220)
    views = views_of(page, board)
    check_board_views(views, board, [], "the photos")
    assert fit_board(board, views).units_per_mm == pytest.approx(SCALE, rel=0.003)


def test_numbers_of_other_programs_are_taken(tmp_path: Path) -> None:
    kalibr = "target_type: 'aprilgrid'\ntagCols: 4\ntagRows: 3\ntagSize: 0.03\ntagSpacing: 0.3\ncodeOffset: 10\n"
    assert read_board(describe(tmp_path, kalibr)).first_id == 10
    charuco = read_board(describe(tmp_path, "kind: charuco\ndictionary: 4x4_50\ncolumns: 5.0\nrows: 7.0\nsquare_mm: 20\nmarker_mm: 15\n"))
    assert charuco == replace(charuco, columns=5, rows=7) and isinstance(charuco.columns, int)
    assert read_board("36h11: 50 mm").marker_mm == 50


def test_our_boards_are_described_by_files() -> None:
    assert BOARDS["a4"] == Board("a4", (210, 297), 7, 10, 25, 18, 0) and BOARDS["a3"].first_id == 100


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("kind: grid\ndictionary: 36h11\ncolumns: 4\nrows: 3\nmarker_mm: 30\n", "'gap_mm' is a required property; expected columns"),
        ("kind: tags\ndictionary: 36h12\nmarker_mm: 30\n", "has the dictionary '36h12'; expected 16h5"),
        (
            "kind: tags\ndictionary: 36h11\nmarker_mm: 0.03\n",
            "marker_mm: 0.03 is less than the minimum of 1; expected marker_mm, in mill",
        ),
        ("kind: tags\ndictionary: 36h11\nmarker_mm: .nan\n", "marker_mm: 'NaN' is not of type 'number'; expected marker_mm, in mill"),
        (
            "kind: grid\ndictionary: 36h11\ncolumns: 4\nrows: 3\nmarker_mm: 30\ngap_mm: .inf\n",
            "gap_mm: 'Infinity' is not of type 'number'",
        ),
        ("kind: bar\ndictionary: 36h11\nids: [3, 3]\ndistance_mm: 100\n", "ids: .*non-unique"),
        ("kind: charuco\ndictionary: 4x4_50\ncolumns: 5\nrows: 7\nsquare_mm: 20\nmarker_mm: 30\n", "expected less than square_mm, 20"),
        ("kind: chess\n", "has the kind 'chess'; expected one of charuco, grid, tags, bar"),
        ("target_type: checkerboard\n", "has the kind 'checkerboard'; expected one of"),
        ("dictionary: 36h11\n", "has no kind; expected one of"),
        ("target_type: aprilgrid\ntagSize: 88mm\n", "needs the numbers tagSize, in metres, and tagSpacing"),
        (
            "kind: grid\ndictionary: 4x4_50\ncolumns: 9\nrows: 6\nmarker_mm: 9\ngap_mm: 3\n",
            "needs the tag 53, but 4x4_50 has 50, counted from 0",
        ),
        ("kind: bar\ndictionary: 36h11\nids: [3, 587]\ndistance_mm: 90\n", "needs the tag 587, but 36h11 has 587"),
        ("a: [", "cannot be read as YAML"),
    ],
)
def test_a_wrong_description_is_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(StepError, match=says):
        read_board(describe(tmp_path, text))


def test_no_board_and_no_tags_are_named(tmp_path: Path) -> None:
    with pytest.raises(StepError, match="there is no board a5; expected a3, a4, a YAML file"):
        read_board("a5")
    assert read_board("A4") == read_board("a4")
    assert read_board("36h11:48.5").marker_mm == 48.5
    board = read_board("36h11:32")
    with pytest.raises(StepError, match="the photos show no tag of the board 36h11:32; check its dictionary"):
        check_board_views(views_of(draw_tags(TAGS, 32, "4X4_50"), board), board, [], "the photos")
