"""Round bodies and mottled materials, which toys and things at home are put together from."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.synthetic.products.canvas import Canvas, parse_color
from zeroshop_steps.synthetic.products.panels import Panel
from zeroshop_steps.synthetic.products.profiles import arc_length, round_polyline
from zeroshop_steps.synthetic.products.solids import ProfileBand, Solid, revolve, sweep_rod, transform_solid

Point = tuple[float, float, float]


def make_ellipsoid(centre: Point, half_axes: Point, panel: str, side_mm: float, turn_deg: Point = (0.0, 0.0, 0.0)) -> Solid:
    """An ellipsoid, mm, turned about x, y and z in this order; its print covers the whole panel, which is `side_mm` wide and high."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 28)
    profile = np.column_stack([np.cos(angle), np.sin(angle)])
    profile[[0, -1], 0] = 0.0
    [patch] = revolve([ProfileBand(profile, panel, side_mm)], segments=48)
    uv_mm = patch.uv_mm * [1.0, side_mm / patch.uv_mm[:, 1].max()]
    turn = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    return [replace(patch, vertices=patch.vertices * half_axes @ turn.T + centre, uv_mm=uv_mm)]


def make_turned(corners: Sequence[tuple[float, ...]], panel: str, side_mm: float, offset: Point = (0.0, 0.0, 0.0)) -> Solid:
    """A turned body, mm: its profile (radius, z[, rounding]) runs from the bottom's centre to the top's; print as of an ellipsoid."""
    profile = round_polyline(corners, step_mm=3.0)
    [patch] = revolve([ProfileBand(profile, panel, side_mm)], segments=72)
    uv_mm = patch.uv_mm * [1.0, side_mm / float(arc_length(profile)[-1])]
    return transform_solid([replace(patch, uv_mm=uv_mm)], np.eye(3), offset)


def make_rod(start: Point, end: Point, radius_mm: float, panel: str, side_mm: float, end_radius_mm: float | None = None) -> Solid:
    """A straight rod, mm, with flat ends, thinner or thicker at its end if asked."""
    path = np.linspace(start, end, 9)
    direction = (path[-1] - path[0]) / np.linalg.norm(path[-1] - path[0])
    across = np.cross(direction, [0.0, 0.0, 1.0] if abs(direction[2]) < 0.9 else [0.0, 1.0, 0.0])
    radii = np.linspace(radius_mm, end_radius_mm or radius_mm, len(path))
    solid = sweep_rod(path, across / np.linalg.norm(across), radii, radii, panel, segments=24)
    most = max(float(patch.uv_mm.max()) for patch in solid)
    return [replace(patch, uv_mm=patch.uv_mm * min(side_mm / most, 1.0)) for patch in solid]


def make_mottled_panel(
    name: str, side_mm: float, colour: str, seed: int, contrast: float = 0.12, draw: Callable[[Canvas], None] | None = None
) -> Panel:
    """A square panel of one colour that is lighter and darker in places, as cloth, skin, clay and wood are; `draw` prints on it."""

    def paint(canvas: Canvas) -> None:
        rng = np.random.default_rng(seed)
        height, width = canvas.pixels.shape[:2]
        light: np.ndarray = np.zeros((height, width), np.float32)
        for octave in range(5):
            grid = rng.normal(size=(6 * 2**octave, 6 * 2**octave)).astype(np.float32)
            light += np.asarray(cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)) / 2**octave
        pixels = parse_color(colour) * (1.0 + contrast * light / light.std() / 2)[..., None]
        canvas.pixels[:] = np.rint(np.clip(pixels, 0, 250)).astype(np.uint8)
        if draw:
            draw(canvas)

    return Panel(name, side_mm, side_mm, paint)
