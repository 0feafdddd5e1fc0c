"""The printed board that gives the scale: a chessboard with an ArUco marker in every white square (ChArUco), and its PDF.

The markers tell the squares apart, so a photo may show a part of the board only. No two boards share a marker, so a photo
shows which board it is.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from scipy.constants import inch

from zeroshop_steps.runtime.files import atomic_write

DICTIONARY = cv2.aruco.DICT_5X5_1000
MM_PER_INCH = inch * 1000
RULER_MM = 150.0
"""Length of the line under the board. The user measures it on paper to find out at which scale the board was printed."""
# The sheet's layout in mm: the board is moved up to make room for the ruler below it and the text below that.
BOARD_RAISED_MM, RULER_BELOW_MM, TEXT_BELOW_MM = 7.0, 8.0, 4.0


@dataclass(frozen=True)
class Board:
    """A board. Its frame: millimetres, x to the right and y down on the paper, origin at the outer corner of the upper left square.

    Attributes:
        name: as on the command line.
        paper_mm: (width, height) of the sheet.
        columns, rows: number of squares.
        square_mm, marker_mm: sides of a square and of the marker in it.
        first_id: number of its first marker; no two of our boards share a number.
        dictionary: of its markers, OpenCV's number.
        legacy: whether a board with an even number of rows has a marker at its upper left, as of OpenCV before 4.6.
    """

    name: str
    paper_mm: tuple[float, float]
    columns: int
    rows: int
    square_mm: float
    marker_mm: float
    first_id: int
    dictionary: int = DICTIONARY
    legacy: bool = False

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of all squares together."""
        return self.columns * self.square_mm, self.rows * self.square_mm

    @property
    def ids(self) -> range:
        """Numbers of its markers."""
        return range(self.first_id, self.first_id + self.columns * self.rows // 2)

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """The same board for OpenCV."""
        dictionary = cv2.aruco.getPredefinedDictionary(self.dictionary)
        ids = np.array(self.ids, np.int32)
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_mm, self.marker_mm, dictionary, ids)
        board.setLegacyPattern(self.legacy)
        return board

    def corners_mm(self) -> np.ndarray:
        """(N, 3) inner corners of the chessboard, in OpenCV's order; z is 0."""
        return np.array(self.charuco.getChessboardCorners(), float)

    def black_mm(self) -> np.ndarray:
        """(N, 4) black rectangles: left, top, width, height. They cover the squares and the black cells of the markers."""
        square, marker = self.square_mm, self.marker_mm
        black = [(c * square, r * square, square, square) for r in range(self.rows) for c in range(self.columns) if (r + c) % 2 == 0]
        dictionary = self.charuco.getDictionary()
        side = dictionary.markerSize + 2
        cell = marker / side
        for number, corners in zip(self.ids, self.charuco.getObjPoints(), strict=True):
            left, top = np.array(corners, float)[:, :2].min(0)
            dark = cv2.aruco.Dictionary.generateImageMarker(dictionary, number, side) == 0
            for row in range(side):
                edges = np.flatnonzero(np.diff(np.r_[False, dark[row], False]))
                black += [(left + a * cell, top + row * cell, (b - a) * cell, cell) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        return np.array(black)


@dataclass(frozen=True)
class TagBoard:
    """Tags without a chessboard. Its frame is that of `Board`; that of a tag alone begins at its upper left corner.

    Attributes:
        name: as on the command line.
        kind: `grid`; `tags`, of one size and anywhere; or `bar`, two tags of which only the distance counts.
        dictionary: OpenCV's number.
        marker_mm: side of the tags' black squares.
        columns, rows, gap_mm, first_id: of a grid; ids rise to the right and then downwards, or upwards if `from_below`.
        ids, distance_mm: of a bar, between the centres.
        border_cells: width of the black border in cells of the code.
    """

    name: str
    kind: str
    dictionary: int
    marker_mm: float = 0.0
    columns: int = 1
    rows: int = 1
    gap_mm: float = 0.0
    first_id: int = 0
    from_below: bool = False
    ids: tuple[int, ...] = ()
    distance_mm: float = 0.0
    border_cells: int = 1

    def corners_mm(self) -> np.ndarray:
        """(4 N, 3) corners of the grid's tags, each clockwise from its upper left, in the order of their ids; z is 0."""
        pitch = self.marker_mm + self.gap_mm
        rows, columns = np.divmod(np.arange(self.columns * self.rows), self.columns)
        rows = self.rows - 1 - rows if self.from_below else rows
        corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]) * self.marker_mm
        flat = (np.stack([columns, rows], 1)[:, None] * pitch + corners).reshape(-1, 2)
        return np.pad(flat, ((0, 0), (0, 1)))


def write_pdf(board: Board, path: Path) -> None:
    """Write the board as a vector PDF of the paper's exact size, with a ruler line to check the print by."""
    figure = draw_sheet(board)
    with matplotlib.rc_context({"pdf.fonttype": 42}), atomic_write(path) as temporary:
        FigureCanvasPdf(figure).print_pdf(temporary, metadata={"CreationDate": None, "Title": f"ZeroShOP board {board.name}"})


def draw_sheet(board: Board) -> Figure:
    """Draw the sheet as a figure whose unit is the millimetre."""
    width, height = board.paper_mm
    figure = Figure(figsize=(width / MM_PER_INCH, height / MM_PER_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0.0, width)
    axes.set_ylim(height, 0.0)
    axes.set_axis_off()
    left, top = (width - board.size_mm[0]) / 2, (height - board.size_mm[1]) / 2 - BOARD_RAISED_MM
    for x, y, w, h in board.black_mm():
        axes.add_patch(Rectangle((left + x, top + y), w, h, facecolor="black", edgecolor="none", antialiased=False))
    start, level = (width - RULER_MM) / 2, top + board.size_mm[1] + RULER_BELOW_MM
    axes.add_line(Line2D([start, start + RULER_MM], [level, level], color="black", linewidth=0.6, solid_capstyle="butt"))
    for tick in np.arange(0.0, RULER_MM + 1.0, 10.0):
        long = 2.5 if tick % 50 == 0 else 1.2
        axes.add_line(Line2D([start + tick] * 2, [level - long, level + long], color="black", linewidth=0.4, solid_capstyle="butt"))
    text = (
        f"ZeroShOP board {board.name}. Print at 100 %, not fitted to the page. The line must be {RULER_MM:g} mm long from end to end;\n"
        "if it is not, give its measured length as height.marker.ruler_mm. Lay the board flat beside the object."
    )
    axes.text(width / 2, level + TEXT_BELOW_MM, text, ha="center", va="top", fontsize=7)
    return figure


def draw_board(board: Board, texels_per_mm: float, margin_mm: float) -> np.ndarray:
    """Draw the board with a white margin as (height, width) float32: 0 black, 1 white, exact shares where an edge crosses a texel."""
    size = np.ceil((np.array(board.size_mm) + 2 * margin_mm) * texels_per_mm).astype(int)
    picture = np.ones((size[1], size[0]), np.float32)
    for x, y, w, h in board.black_mm() * texels_per_mm:
        across = _coverage(x + margin_mm * texels_per_mm, w, size[0])
        down = _coverage(y + margin_mm * texels_per_mm, h, size[1])
        columns, rows = np.flatnonzero(across), np.flatnonzero(down)
        picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] -= np.outer(down[rows], across[columns])
    return np.clip(picture, 0.0, 1.0)


def _coverage(start: float, length: float, count: int) -> np.ndarray:
    """(count,) the share of each unit cell that lies between `start` and `start + length`."""
    cells = np.arange(count)
    return np.clip(np.minimum(cells + 1, start + length) - np.maximum(cells, start), 0.0, 1.0)
