"""A printed surface measured in millimetres: polygons, lines and text with flat, linear and radial fills.

Coordinates are millimetres from the upper left corner, x to the right, y down, as on a printer's sheet.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

Points = Sequence[tuple[float, float]] | np.ndarray

FONTS = {
    "sans": "DejaVuSans.ttf",
    "bold": "DejaVuSans-Bold.ttf",
    "oblique": "DejaVuSans-BoldOblique.ttf",
    "serif": "DejaVuSerif-Bold.ttf",
    "script": "DejaVuSerif-BoldItalic.ttf",
    "mono": "DejaVuSansMono.ttf",
}
CAP_HEIGHT_PER_EM = 0.729  # of the DejaVu family


@dataclass(frozen=True)
class LinearGradient:
    """A gradient over a shape's bounding box, from `start` (top) to `end` (bottom), or left to right."""

    start: str
    end: str
    horizontal: bool = False


@dataclass(frozen=True)
class RadialGradient:
    """A gradient from `inner` at `centre` (fractions of the bounding box) to `outer` at `reach` bounding-box halves."""

    inner: str
    outer: str
    centre: tuple[float, float] = (0.4, 0.35)
    reach: float = 1.3


Fill = str | LinearGradient | RadialGradient


def parse_color(colour: str) -> np.ndarray:
    """(3,) float32 in 0..255 of "#rrggbb"."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], np.float32)


class Canvas:
    """A sheet of `width_mm` x `height_mm` at `px_per_mm`."""

    def __init__(self, width_mm: float, height_mm: float, px_per_mm: float, size_px: tuple[int, int]) -> None:
        self.width_mm, self.height_mm = width_mm, height_mm
        self.scale = np.array([size_px[0] / width_mm, size_px[1] / height_mm])
        self.px_per_mm = px_per_mm
        self.pixels = np.full((size_px[1], size_px[0], 3), 255, np.uint8)

    def fill(self, fill: Fill) -> None:
        """Cover the whole sheet."""
        if isinstance(fill, str):
            self.pixels[:] = parse_color(fill)
            return
        self.rectangle(0, 0, self.width_mm, self.height_mm, fill)

    def rectangle(self, x: float, y: float, width: float, height: float, fill: Fill, alpha: float = 1.0, radius: float = 0.0) -> None:
        """An axis-aligned rectangle with its upper left corner at (x, y) and rounded corners of `radius` mm."""
        if radius <= 0:
            corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
        else:
            arc = np.linspace(0, np.pi / 2, 12)
            left, right, top, bottom = x + radius, x + width - radius, y + radius, y + height - radius
            centres = ((right, bottom), (left, bottom), (left, top), (right, top))
            corners = [
                (cx + radius * np.cos(a + quarter * np.pi / 2), cy + radius * np.sin(a + quarter * np.pi / 2))
                for quarter, (cx, cy) in enumerate(centres)
                for a in arc
            ]
        self.polygon(corners, fill, alpha)

    def ellipse(
        self, x: float, y: float, rx: float, ry: float, fill: Fill, alpha: float = 1.0, soft_mm: float = 0.0, turn: float = 0.0
    ) -> None:
        """An ellipse about (x, y), turned by `turn` degrees."""
        angle = np.linspace(0, 2 * np.pi, 96, endpoint=False)
        self.polygon(rotate_points(np.stack([rx * np.cos(angle), ry * np.sin(angle)], 1), turn) + (x, y), fill, alpha, soft_mm)

    def ring(self, x: float, y: float, radius: float, width: float, fill: Fill, alpha: float = 1.0) -> None:
        """A circle line of `width` mm."""
        angle = np.linspace(0, 2 * np.pi, 121)
        self.line(np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], 1), width, fill, alpha)

    def polygon(self, points: Points, fill: Fill, alpha: float = 1.0, soft_mm: float = 0.0) -> None:
        """A filled polygon; `soft_mm` blurs its border, for shadows and glows."""
        corners = np.asarray(points, float) * self.scale
        pad = int(3 * soft_mm * self.px_per_mm) + 2
        left, top = np.floor(corners.min(0)).astype(int) - pad
        right, bottom = np.ceil(corners.max(0)).astype(int) + pad
        mask = Image.new("L", (right - left, bottom - top))
        ImageDraw.Draw(mask).polygon([(px - left, py - top) for px, py in corners], fill=255)
        coverage = np.asarray(mask)
        if soft_mm > 0:
            coverage = cv2.GaussianBlur(coverage, (0, 0), soft_mm * self.px_per_mm)
        self._paint(coverage, left, top, fill, alpha, pad)

    def line(self, points: Points, width: float, fill: Fill, alpha: float = 1.0) -> None:
        """An open line of `width` mm with round joints."""
        corners = np.asarray(points, float) * self.scale
        width_px = max(width * self.px_per_mm, 1.0)
        pad = int(width_px) + 2
        left, top = np.floor(corners.min(0)).astype(int) - pad
        right, bottom = np.ceil(corners.max(0)).astype(int) + pad
        mask = np.zeros((bottom - top, right - left), np.uint8)
        fixed = np.rint((corners - (left, top)) * 16).astype(np.int32)
        cv2.polylines(mask, [fixed.reshape(-1, 1, 2)], False, 255, max(int(round(width_px)), 1), cv2.LINE_AA, 4)
        self._paint(mask, left, top, fill, alpha, pad)

    def text(
        self,
        x: float,
        y: float,
        words: str,
        cap_mm: float,
        fill: Fill,
        font: str = "bold",
        align: str = "middle",
        stretch: float = 1.0,
        max_width: float | None = None,
        arch_mm: float = 0.0,
        turn: float = 0.0,
        edge: str | None = None,
        edge_mm: float = 0.0,
    ) -> float:
        """One line of text on the baseline y; returns its width in mm.

        Args:
            x, y: anchor on the baseline: its left end, middle or right end, as `align` says.
            cap_mm: height of a capital letter.
            stretch: width factor of the letters; reduced further where `max_width` (mm) asks for it.
            arch_mm: how much the middle rises above the ends.
            turn: degrees, counter-clockwise, about the anchor.
            edge, edge_mm: colour and width of an outline around the letters.
        """
        face = _font(font, max(round(cap_mm * self.px_per_mm / CAP_HEIGHT_PER_EM), 4))
        rim = int(round(edge_mm * self.px_per_mm)) + 1
        left, top, right, bottom = map(int, face.getbbox(words, anchor="ls"))
        left, top, right, bottom = left - rim, top - rim, right + rim, bottom + rim
        mask = Image.new("L", (max(right - left, 1), max(bottom - top, 1)))
        ImageDraw.Draw(mask).text((-left, -top), words, fill=255, font=face, anchor="ls")
        if max_width is not None:
            stretch = min(stretch, max_width * self.px_per_mm / mask.width)
        if stretch != 1.0:
            mask = mask.resize((max(round(mask.width * stretch), 1), mask.height), Image.Resampling.LANCZOS)
        baseline: float = -top
        coverage = np.asarray(mask)
        if arch_mm:
            coverage, baseline = _arch(coverage, -top, arch_mm * self.px_per_mm)
        anchor_x = {"left": rim * stretch, "middle": coverage.shape[1] / 2, "right": coverage.shape[1] - rim * stretch}[align]
        width_mm = coverage.shape[1] / self.px_per_mm
        if turn:
            coverage, anchor_x, baseline = _rotate(coverage, anchor_x, baseline, turn)
        origin = np.rint(np.array([x, y]) * self.scale - (anchor_x, baseline)).astype(int)
        if edge is not None:
            size = 2 * rim + 1
            wide = cv2.dilate(coverage, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
            self._paint(wide, origin[0], origin[1], edge, 1.0, 0)
        self._paint(coverage, origin[0], origin[1], fill, 1.0, 0)
        return width_mm

    def text_width(self, words: str, cap_mm: float, font: str = "bold") -> float:
        """Width in mm that `text` would use unstretched."""
        return _font(font, max(round(cap_mm * self.px_per_mm / CAP_HEIGHT_PER_EM), 4)).getlength(words) / self.px_per_mm

    def _paint(self, coverage: np.ndarray, left: int, top: int, fill: Fill, alpha: float, pad: int) -> None:
        height, width = coverage.shape
        x0, y0 = max(left, 0), max(top, 0)
        x1, y1 = min(left + width, self.pixels.shape[1]), min(top + height, self.pixels.shape[0])
        if x1 <= x0 or y1 <= y0:
            return
        window = (slice(y0 - top, y1 - top), slice(x0 - left, x1 - left))
        weight = (coverage[window].astype(np.float32) * (alpha / 255.0))[..., None]
        colour = _sample_fill(fill, (height, width), pad, window)
        under = self.pixels[y0:y1, x0:x1]
        self.pixels[y0:y1, x0:x1] = (under + (colour - under) * weight + 0.5).astype(np.uint8)


def rotate_points(points: Points, degrees: float) -> np.ndarray:
    """Points (N, 2) turned about the origin; positive turns are clockwise on the sheet, because y points down."""
    angle = np.deg2rad(degrees)
    return np.asarray(points, float) @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def _sample_fill(fill: Fill, shape: tuple[int, int], pad: int, window: tuple[slice, slice]) -> np.ndarray:
    if isinstance(fill, str):
        return parse_color(fill)
    height, width = shape
    y = (np.arange(height, dtype=np.float32)[window[0], None] - pad) / max(height - 2 * pad - 1, 1)
    x = (np.arange(width, dtype=np.float32)[None, window[1]] - pad) / max(width - 2 * pad - 1, 1)
    if isinstance(fill, LinearGradient):
        amount, start, end = np.broadcast_to(x if fill.horizontal else y, (y.shape[0], x.shape[1])), fill.start, fill.end
    else:
        amount, start, end = np.hypot(x - fill.centre[0], y - fill.centre[1]) * 2 / fill.reach, fill.inner, fill.outer
    return parse_color(start) + (parse_color(end) - parse_color(start)) * np.clip(amount, 0, 1)[..., None]


def _arch(coverage: np.ndarray, baseline: int, rise_px: float) -> tuple[np.ndarray, int]:
    height, width = coverage.shape
    room = int(np.ceil(abs(rise_px)))
    offset = rise_px * (1 - np.linspace(-1, 1, width, dtype=np.float32) ** 2) + (room if rise_px < 0 else 0)
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height + room, dtype=np.float32))
    rows = rows - room + offset[None, :] if rise_px > 0 else rows - room + offset[None, :]
    return cv2.remap(coverage, columns, rows.astype(np.float32), cv2.INTER_LINEAR), baseline + room


def _rotate(coverage: np.ndarray, anchor_x: float, anchor_y: float, degrees: float) -> tuple[np.ndarray, float, float]:
    height, width = coverage.shape
    matrix = cv2.getRotationMatrix2D((anchor_x, anchor_y), degrees, 1.0)
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]]) @ matrix.T
    low, high = np.floor(corners.min(0)), np.ceil(corners.max(0))
    matrix[:, 2] -= low
    size = (high - low).astype(int)
    return cv2.warpAffine(coverage, matrix, (int(size[0]), int(size[1])), flags=cv2.INTER_LINEAR), anchor_x - low[0], anchor_y - low[1]


@lru_cache(maxsize=256)
def _font(name: str, size_px: int) -> ImageFont.FreeTypeFont:
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / FONTS[name]
    return ImageFont.truetype(str(path), size_px, layout_engine=ImageFont.Layout.BASIC)
