"""Closed solids made of UV-mapped patches: bodies of revolution, rounded boxes, extrusions and bent rods.

Model frame: millimetres, z up, front towards +x, so that a reader in front has +y on the right. All faces are
counter-clockwise from outside, in space and on their panel: print is never mirrored.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import manifold3d
import numpy as np

from zeroshop_steps.synthetic.products.canvas import Canvas
from zeroshop_steps.synthetic.products.panels import Panel, make_plain_panel
from zeroshop_steps.synthetic.products.profiles import arc_length, sample_superellipse


@dataclass(frozen=True)
class SurfacePatch:
    """A piece of surface on one panel.

    Attributes:
        vertices: (V, 3) mm.
        faces: (F, 3) vertex indices.
        uv_mm: (V, 2) position on the panel in mm from its lower left corner.
        panel: the panel's name.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uv_mm: np.ndarray
    panel: str


Solid = list[SurfacePatch]
"""Patches that together enclose a volume; shared borders have equal positions."""


@dataclass(frozen=True)
class ProfileBand:
    """A stretch of a revolved profile on one panel.

    Attributes:
        points: (K, 2) radius and z, walked with the outside on the right hand: up the outer wall, down an inner one.
        panel: name of the panel.
        width_mm: of the panel: a wall's once-around length, a disc's diameter.
        look: the panel's colour, or what prints it.
        disc: None for a wall (u around, v along the profile), "up" or "down" for a disc seen from above or below.
        density: of the panel.
    """

    points: np.ndarray
    panel: str
    width_mm: float
    look: str | Callable[[Canvas], None] = "#ffffff"
    disc: str | None = None
    density: float = 1.0

    def make_panel(self) -> Panel:
        """The panel, as long as the profile, or square for a disc."""
        height_mm = float(arc_length(self.points)[-1]) if self.disc is None else self.width_mm
        if isinstance(self.look, str):
            return make_plain_panel(self.panel, self.width_mm, height_mm, self.look)
        return Panel(self.panel, self.width_mm, height_mm, self.look, self.density)


Section = Callable[[float, float], tuple[float, float, float]]


def circle(radius: float, z: float) -> tuple[float, float, float]:
    """The round cross-section: half extents in x and y, and the superellipse's exponent."""
    return radius, radius, 2.0


def revolve(
    bands: Sequence[ProfileBand],
    segments: int = 128,
    seam_rad: float = np.pi,
    section: Section = circle,
) -> Solid:
    """A body whose cross-sections are circles or superellipses; the first and last profile points have radius 0.

    Args:
        bands: consecutive stretches of the profile, from the bottom's centre outwards and up.
        seam_rad: direction in which the print's left and right ends meet.
        section: half extents and exponent for a profile's radius and z.
    """
    fractions = np.arange(segments + 1) / segments
    solid = []
    for band in bands:
        rings = []
        for radius, z in band.points:
            half_x, half_y, exponent = section(radius, z)
            ring = sample_superellipse(half_x, half_y, exponent, fractions, seam_rad) if radius > 0 else np.zeros((segments + 1, 2))
            ring[-1] = ring[0]
            rings.append(np.column_stack([ring, np.full(segments + 1, z)]))
        grid = np.stack(rings)
        if band.disc is None:
            uv = np.stack(np.broadcast_arrays(fractions[None, :] * band.width_mm, arc_length(band.points)[:, None]), -1)
        else:
            away = 1.0 if band.disc == "down" else -1.0
            uv = np.stack([grid[..., 1], away * grid[..., 0]], -1) + band.width_mm / 2
        solid.append(_make_grid_patch(grid, uv, band.panel))
    return solid


def make_rounded_box(size_mm: tuple[float, float, float], radius: float, step_mm: float = 3.0, bulge_mm: float = 0.0) -> Solid:
    """A box with rounded edges on the panels front (+x), right (+y), back, left, top and bottom, each the size of its side.

    Args:
        size_mm: extents in x, y and z, without the bulge.
        radius: of the edges.
        step_mm: longest edge of the grid.
        bulge_mm: how far the four walls' middles stand out, as filled cartons do.
    """
    half = np.array(size_mm) / 2
    sides = {
        "front": ("+y", "+z"),
        "back": ("-y", "+z"),
        "right": ("-x", "+z"),
        "left": ("+x", "+z"),
        "top": ("+y", "-x"),
        "bottom": ("+y", "+x"),
    }
    solid = []
    for name, (right_name, up_name) in sides.items():
        right, up = _axis(right_name), _axis(up_name)
        normal = np.cross(right, up)
        half_right, half_up, half_normal = (float(np.abs(axis) @ half) for axis in (right, up, normal))
        a, b = _make_box_grid(half_right, radius, step_mm), _make_box_grid(half_up, radius, step_mm)
        flat = a[None, :, None] * right + b[:, None, None] * up + half_normal * normal
        core = np.clip(flat, radius - half, half - radius)
        out = flat - core
        grid = core + radius * out / np.linalg.norm(out, axis=-1, keepdims=True)
        if name not in ("top", "bottom"):
            swell = (1 - (a[None, :] / half_right) ** 2) * (1 - (b[:, None] / half_up) ** 2)
            grid = grid + bulge_mm * swell[..., None] * normal
        uv = np.stack(np.broadcast_arrays(a[None, :] + half_right, b[:, None] + half_up), -1)
        solid.append(_make_grid_patch(grid, uv, name))
    return solid


def extrude(
    outline: np.ndarray,
    z_low: float,
    z_high: float,
    panel_up: str,
    panel_down: str,
    panel_side: str,
    edge_mm: float = 1.0,
) -> Solid:
    """A plate of an outline (N, 2), counter-clockwise in x and y, with rounded edges of radius `edge_mm` and a ring about every 3 mm.

    The caps' panels have the outline's bounding box (u along y, as a reader in front sees them); the side's panel is as
    wide as the outline is long.
    """
    tangent = np.roll(outline, -1, 0) - np.roll(outline, 1, 0)
    outward = np.stack([tangent[:, 1], -tangent[:, 0]], 1) / np.linalg.norm(tangent, axis=1, keepdims=True)
    arc = np.linspace(0, np.pi / 2, 5)
    inset = edge_mm * (1 - np.sin(arc))
    rise = edge_mm * (1 - np.cos(arc))
    middle = np.linspace(z_low + edge_mm, z_high - edge_mm, max(int((z_high - z_low) / 3.0), 1) + 1)[1:-1]
    levels = [*zip(z_low + rise, inset, strict=True), *((z, 0.0) for z in middle), *zip(z_high - rise[::-1], inset[::-1], strict=True)]
    rings = [np.column_stack([outline - inset_mm * outward, np.full(len(outline), z)]) for z, inset_mm in levels]
    grid = np.stack([np.concatenate([ring, ring[:1]]) for ring in rings])
    around = arc_length(np.concatenate([outline, outline[:1]]))
    up = arc_length(np.array([(inset_mm, z) for z, inset_mm in levels]))
    solid = [_make_grid_patch(grid, np.stack(np.broadcast_arrays(around[None, :], up[:, None]), -1), panel_side)]
    low, high = outline.min(0), outline.max(0)
    triangles = np.asarray(manifold3d.triangulate([rings[0][:, :2]]), np.int64)
    below = np.stack([rings[0][:, 1] - low[1], rings[0][:, 0] - low[0]], 1)
    above = np.stack([rings[-1][:, 1] - low[1], high[0] - rings[-1][:, 0]], 1)
    solid.append(SurfacePatch(rings[0], triangles[:, ::-1], below, panel_down))
    solid.append(SurfacePatch(rings[-1], triangles, above, panel_up))
    return solid


def sweep_rod(path: np.ndarray, binormal: np.ndarray, half_out: np.ndarray, half_side: np.ndarray, panel: str, segments: int = 32) -> Solid:
    """A rod with elliptic cross-sections along a path (K, 3) in the plane across `binormal`, closed by flat ends.

    Args:
        half_out, half_side: (K,) half extents in the path's plane and along the binormal, mm.
        panel: as wide as the path is long, and as high as the largest cross-section's girth.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    out = np.cross(tangent, binormal)
    angle = 2 * np.pi * np.arange(segments + 1) / segments
    angle[-1] = 0.0
    ring = np.cos(angle)[None, :, None] * half_out[:, None, None] * out[:, None]
    grid = path[:, None] + ring - np.sin(angle)[None, :, None] * half_side[:, None, None] * binormal
    girth = np.pi * float(np.max(half_out + half_side))
    uv = np.stack(np.broadcast_arrays(np.linspace(0, girth, segments + 1)[None, :], arc_length(path)[:, None]), -1)
    solid = [_make_grid_patch(grid, uv, panel)]
    fan = np.stack([np.zeros(segments, int), 1 + np.arange(segments), 2 + np.arange(segments)], 1)
    for end, order in ((0, fan[:, ::-1]), (-1, fan)):
        vertices = np.concatenate([path[end : end + 1] if end == 0 else path[-1:], grid[end]])
        solid.append(SurfacePatch(vertices, order, np.full((len(vertices), 2), 0.5) * girth, panel))
    return solid


def transform_solid(solid: Solid, matrix: np.ndarray, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> Solid:
    """The solid after x -> matrix x + offset; the matrix (3, 3) must be a rotation."""
    return [replace(patch, vertices=patch.vertices @ np.asarray(matrix, float).T + np.asarray(offset, float)) for patch in solid]


def _axis(name: str) -> np.ndarray:
    axis = np.zeros(3)
    axis["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return axis


def _make_box_grid(half: float, radius: float, step_mm: float) -> np.ndarray:
    rim = radius * np.tan(np.linspace(0, np.pi / 4, 4)[1:])
    inner = np.linspace(-(half - radius), half - radius, max(int(np.ceil(2 * (half - radius) / step_mm)), 2) + 1)
    return np.concatenate([-(half - radius) - rim[::-1], inner, half - radius + rim])


def _make_grid_patch(grid: np.ndarray, uv: np.ndarray, panel: str) -> SurfacePatch:
    """Two triangles per cell of a grid (rows upwards, columns to the right, seen from outside); degenerate ones dropped."""
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    vertices = grid.reshape(-1, 3)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return SurfacePatch(vertices, faces[area > 1e-9], uv.reshape(-1, 2).astype(float), panel)
