"""Small plots as SVG inside the page: they take its colours, by day and by night, and need no script.

Matplotlib, tried instead, draws the same lines. A loss curve of 76 points then takes 14.3 kB instead of 2.1 kB, Figure 4.8 14.8 kB
instead of 2.8 kB, and a chart 77 ms of CPU instead of 0.1 ms. It writes colours into each element and has no tooltips, so the page's
colours and the points' names would have to be put into its output by regular expressions. Plotly's charts need its script.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup, escape

from zeroshop_steps.geometry.cameras.pinhole import SparseModel
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.report.site.viewer_data import VIEW_PX

MARGIN = 24
WIDTH, HEIGHT = 560, 300
LEFT, RIGHT, TOP, BOTTOM = 56, 14, 14, 44  # margins for the numbers and names of the axes
# Places of text beside the axes, in the chart's units, which are pixels where it is shown at full width.
BELOW, BESIDE, DOWN = 16, 6, 4  # baselines of numbers below the x axis, left of the y axis, and down to its middle
NAME_BELOW, NAME_LEFT = 6, 13  # baselines of the axes' names, from the lower and from the left edge
LEAST_FOR_TREND = 3  # points; two always lie on a line


class _Axes:
    """Where a value lies in the picture."""

    def __init__(self, x: Sequence[float], y: Sequence[float], log_y: bool = False, from_zero: bool = False) -> None:
        self.log_y = log_y
        self.x0, self.x1 = _range(x)
        values = [math.log10(value) for value in y if value > 0] if log_y else [*y, *([0.0] if from_zero else [])]
        self.y0, self.y1 = _range(values)
        if from_zero and not log_y:
            self.y0 = 0.0

    def x(self, value: float) -> float:
        return LEFT + (value - self.x0) / (self.x1 - self.x0) * (WIDTH - LEFT - RIGHT)

    def y(self, value: float) -> float:
        level = math.log10(value) if self.log_y else value
        return HEIGHT - BOTTOM - (level - self.y0) / (self.y1 - self.y0) * (HEIGHT - TOP - BOTTOM)

    def grid(self, x_label: str, y_label: str) -> list[str]:
        """Lines, numbers and the names of the axes."""
        parts = []
        across = ticks(self.x0, self.x1)
        for value in across:
            parts.append(
                f'<text x="{self.x(value):.1f}" y="{HEIGHT - BOTTOM + BELOW}" text-anchor="middle">{_told_apart(value, across)}</text>'
            )
        levels = range(math.ceil(self.y0), math.floor(self.y1) + 1) if self.log_y else ticks(self.y0, self.y1)
        for level in levels:
            value = 10.0**level if self.log_y else level
            y, label = self.y(value), _short(value) if self.log_y else _told_apart(value, levels)
            parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(f'<text x="{LEFT - BESIDE}" y="{y + DOWN:.1f}" text-anchor="end">{label}</text>')
        parts.append(f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{HEIGHT - NAME_BELOW}" text-anchor="middle">{escape(x_label)}</text>')
        middle = (TOP + HEIGHT - BOTTOM) / 2
        parts.append(f'<text transform="translate({NAME_LEFT} {middle}) rotate(-90)" text-anchor="middle">{escape(y_label)}</text>')
        return parts


def line_chart(series: Mapping[str, Sequence[tuple[float, float]]], x_label: str, y_label: str, log_y: bool = False) -> Markup:
    """One line a name; nothing where no series has two points."""
    shown = {name: [(x, y) for x, y in points if not log_y or y > 0] for name, points in series.items()}
    shown = {name: points for name, points in shown.items() if len(points) > 1}
    if not shown:
        return Markup("")
    axes = _Axes([x for points in shown.values() for x, _ in points], [y for points in shown.values() for _, y in points], log_y)
    parts = axes.grid(x_label, y_label)
    for k, points in enumerate(shown.values()):
        path = " ".join(f"{axes.x(x):.1f},{axes.y(y):.1f}" for x, y in points)
        parts.append(f'<polyline class="series {_style(k)}" points="{path}"/>')
    return _figure(parts, list(shown), f"{y_label} over {x_label}")


def scatter(
    series: Mapping[str, Sequence[tuple[float, float, str]]], x_label: str, y_label: str, trend: bool = False, from_zero: bool = True
) -> Markup:
    """One colour a name; each point is (x, y, what it is). With `trend`, a straight line through each series of three or more."""
    shown = {name: list(points) for name, points in series.items() if points}
    if not shown:
        return Markup("")
    every = [point for points in shown.values() for point in points]
    axes = _Axes([point[0] for point in every], [point[1] for point in every], from_zero=from_zero)
    parts = axes.grid(x_label, y_label)
    for k, points in enumerate(shown.values()):
        if trend and len(points) >= LEAST_FOR_TREND:
            slope, level = _straight(points)
            ends = [min(point[0] for point in points), max(point[0] for point in points)]
            inside = [(x, max(level + slope * x, 0.0)) for x in ends]
            parts.append(
                f'<polyline class="series {_style(k)}" points="{" ".join(f"{axes.x(x):.1f},{axes.y(y):.1f}" for x, y in inside)}"/>'
            )
        for x, y, what in points:
            title = f"<title>{escape(what)}: {_short(x)}, {_short(y)}</title>"
            # Large enough for a pointer, which asks for its name.
            parts.append(f'<circle class="dot {_style(k)}" cx="{axes.x(x):.1f}" cy="{axes.y(y):.1f}" r="4.5">{title}</circle>')
    return _figure(parts, list(shown), f"{y_label} over {x_label}")


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers between two values."""
    rough = (high - low) / about
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough * 0.999)
    return [round(k * step, 12) for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _range(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    room = (high - low) * 0.04 or abs(high) * 0.1 or 1.0
    return low - room, high + room


def _straight(points: Sequence[tuple[float, float, str]]) -> tuple[float, float]:
    count = len(points)
    mean_x, mean_y = sum(point[0] for point in points) / count, sum(point[1] for point in points) / count
    spread = sum((point[0] - mean_x) ** 2 for point in points) or 1.0
    slope = sum((point[0] - mean_x) * (point[1] - mean_y) for point in points) / spread
    return slope, mean_y - slope * mean_x


def _short(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1e4 else f"{value / 1000:.4g} k"


def _told_apart(value: float, others: Sequence[float]) -> str:
    """A number with as many digits as its neighbours on the axis need."""
    step = min((b - a for a, b in zip(others, others[1:], strict=False)), default=1.0)
    return _short(value) if abs(value) >= 1e4 else f"{value:.{max(0, -math.floor(math.log10(step) + 1e-9))}f}"


def _style(k: int) -> str:
    """The class of a series, which has a colour in the page's styles."""
    # The classes s1 to s5 of assets/report.css.
    return f"s{k % 5 + 1}"


def _figure(parts: list[str], names: list[str], title: str) -> Markup:
    keys = "".join(f'<li><i class="{_style(k)}"></i>{escape(name)}</li>' for k, name in enumerate(names))
    drawing = f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">{"".join(parts)}</svg>'
    return Markup(f'<div class="chart">{drawing}<ul class="keys">{keys}</ul></div>')


def camera_plan(model: SparseModel, object_from_registration: np.ndarray, unit: str) -> Markup:
    """Centres and view directions of the registered cameras around the object: from above (x to the right) and from the side."""
    moved = [transform_camera(camera, object_from_registration) for camera in model.cameras]
    centres = np.array([camera.centre_in_world for camera in moved])
    forward = np.array([camera.camera_from_world[2, :3] for camera in moved])
    names = [camera.name for camera in model.cameras]
    radius = float(np.abs(centres).max()) * 1.05
    away = np.linalg.norm(centres[:, :2], axis=1)
    outward = np.einsum("ij,ij->i", forward[:, :2], centres[:, :2]) / np.maximum(away, 1e-12)
    above = _picture(centres[:, :2], forward[:, :2], names, radius, "from above")
    side = _picture(
        np.stack([away, centres[:, 2]], 1), np.stack([outward, forward[:, 2]], 1), names, radius, "from the side: distance and height"
    )
    note = f"{len(moved)} cameras, up to {np.linalg.norm(centres, axis=1).max():.4g} {escape(unit)} from the object"
    return Markup(f'<div class="plan">{above}{side}</div><figcaption>{note}</figcaption>')


def _picture(places: np.ndarray, directions: np.ndarray, names: list[str], radius: float, title: str) -> str:
    def at(place: np.ndarray) -> tuple[float, float]:
        x, y = VIEW_PX / 2 + place / radius * (VIEW_PX / 2 - MARGIN) * (1, -1)
        return round(float(x), 1), round(float(y), 1)

    parts = [f'<line class="grid" x1="0" x2="{VIEW_PX}" y1="{VIEW_PX / 2}" y2="{VIEW_PX / 2}"/>']
    parts.append(f'<line class="grid" x1="{VIEW_PX / 2}" x2="{VIEW_PX / 2}" y1="0" y2="{VIEW_PX}"/>')
    parts.append(
        f'<rect class="dot s2" x="{VIEW_PX / 2 - 5}" y="{VIEW_PX / 2 - 5}" width="10" height="10"><title>the object</title></rect>'
    )
    for place, direction, name in zip(places, directions, names, strict=True):
        (x, y), (tip_x, tip_y) = at(place), at(place + direction * radius * 0.13)
        parts.append(f'<line class="series s1" x1="{x}" y1="{y}" x2="{tip_x}" y2="{tip_y}"/>')
        parts.append(f'<circle class="dot s1" cx="{x}" cy="{y}" r="4"><title>{escape(name)}</title></circle>')
    parts.append(f'<text x="8" y="{VIEW_PX - 8}">{escape(title)}</text>')
    return f'<svg viewBox="0 0 {VIEW_PX} {VIEW_PX}" role="img" aria-label="cameras {escape(title)}">{"".join(parts)}</svg>'
