"""Things for the desk and the workshop: a pen-thin marker and a spring clamp."""

from collections.abc import Sequence

import numpy as np

from zeroshop_steps.synthetic.products.assemble import Product
from zeroshop_steps.synthetic.products.canvas import Canvas, LinearGradient, rotate_points
from zeroshop_steps.synthetic.products.panels import Panel, make_plain_panel
from zeroshop_steps.synthetic.products.printing import draw_barcode, draw_paragraph, draw_recycling_mark
from zeroshop_steps.synthetic.products.profiles import arc_length, round_polyline
from zeroshop_steps.synthetic.products.solids import ProfileBand, Solid, extrude, revolve, sweep_rod

MARKER_GREEN, CLAMP_BLACK, CLAMP_ORANGE, CLAMP_STEEL = "#118a4e", "#2b2d30", "#ef7d1a", "#b9bec3"
FLIP_Y = np.diag([1.0, -1.0])


def marker() -> Product:
    """A whiteboard marker of 19 mm diameter and 140 mm height that stands on its end."""
    barrel = round_polyline([(7.0, 0.0), (8.6, 0.0, 1.0), (9.0, 5.0, 1.0), (9.0, 92.0)], step_mm=2.5)
    cap = round_polyline([(9.0, 92.0), (9.8, 92.0, 0.3), (9.8, 130.0, 6.0), (8.6, 140.0, 1.2), (6.0, 140.0)], step_mm=2.0)
    top = round_polyline([(6.0, 140.0), (0.0, 140.0)], step_mm=2.0)
    foot = round_polyline([(0.0, 0.6), (6.2, 0.6, 0.3), (7.0, 0.0)], step_mm=2.0)
    girth = 2 * np.pi * 9.0
    bands = [
        ProfileBand(foot, "foot", 14.0, MARKER_GREEN, "down"),
        ProfileBand(barrel, "barrel", girth, _print_barrel),
        ProfileBand(cap, "cap", girth, _print_cap, density=0.5),
        ProfileBand(top, "top", 12.0, MARKER_GREEN, "up"),
    ]
    path = round_polyline([(9.0, 128.0), (12.4, 128.0, 2.2), (12.4, 98.0)], step_mm=2.0)
    clip = sweep_rod(
        np.column_stack([np.zeros(len(path)), path]),
        np.array([1.0, 0.0, 0.0]),
        np.full(len(path), 0.9),
        np.full(len(path), 2.6),
        "clip",
        segments=24,
    )
    side = make_plain_panel("clip", np.pi * 3.5, float(arc_length(path)[-1]), "#0c6b3c")
    return Product([revolve(bands, segments=96), clip], [*(band.make_panel() for band in bands), side])


def clamp() -> Product:
    """A spring clamp lying on its side, 155 mm long and 28 mm high, with its jaws a little open."""
    lever = [(-78, 33, 6), (-34, 17, 12), (-2, 15, 10), (26, 36, 14), (52, 31, 14), (67, 12, 4), (67, 5, 3), (57, 5, 3)]
    lever += [(53, 13, 5), (44, 20, 10), (31, 23, 10), (12, 4, 6), (0, -9, 6), (-12, -4, 6), (-34, 4, 14), (-81, 22, 5)]
    grip = [(-86, 20, 6), (-80, 37, 6), (-36, 20.5, 5), (-38, 2.5, 5)]
    pad = [(54, 3, 2.5), (53.5, 13, 3), (69, 14, 3), (70, 3, 2.5)]
    parts: dict[str, tuple[Sequence[tuple[float, ...]], bool, tuple[float, float], float]] = {
        "lever_a": (lever, False, (5.0, 23.0), 1.5),
        "lever_b": (lever, True, (5.5, 22.5), 1.5),
        "grip_a": (grip, False, (1.0, 27.0), 2.5),
        "grip_b": (grip, True, (1.0, 27.0), 2.5),
        "pad_a": (pad, False, (2.0, 26.0), 1.2),
        "pad_b": (pad, True, (2.0, 26.0), 1.2),
    }
    solids: list[Solid] = []
    panels: list[Panel] = []
    for name, (corners, mirrored, (low, high), edge) in parts.items():
        solid, its_panels = _make_plate(name, corners, mirrored, low, high, edge)
        solids.append(solid)
        panels += its_panels
    hub, hub_panels = _make_hub()
    return Product([*solids, hub], panels + hub_panels)


def _make_plate(
    name: str, corners: Sequence[tuple[float, ...]], mirrored: bool, low: float, high: float, edge_mm: float
) -> tuple[Solid, list[Panel]]:
    """A rounded plate and its panels; corners are given clockwise, and mirrored at y = 0 where asked."""
    outline = round_polyline(corners, step_mm=2.5, closed=True)
    outline = outline @ FLIP_Y if mirrored else outline[::-1]
    solid = extrude(outline, low, high, f"{name}_up", f"{name}_down", f"{name}_side", edge_mm)
    low_xy, size = outline.min(0), np.ptp(outline, axis=0)
    around = float(arc_length(np.concatenate([outline, outline[:1]]))[-1])
    colour = CLAMP_BLACK if name.startswith("lever") else CLAMP_ORANGE
    up = (
        Panel(f"{name}_up", size[1], size[0], lambda canvas: _print_lever(canvas, low_xy))
        if name == "lever_a"
        else make_plain_panel(f"{name}_up", size[1], size[0], colour)
    )
    if name == "grip_b":
        up = Panel(f"{name}_up", size[1], size[0], _print_grip)
    panels = [
        up,
        make_plain_panel(f"{name}_down", size[1], size[0], colour),
        make_plain_panel(f"{name}_side", around, high - low + 2 * edge_mm, colour),
    ]
    return solid, panels


def _make_hub() -> tuple[Solid, list[Panel]]:
    """The pivot: a steel drum with the turns of its spring, and a bolt on either side."""
    radius, turns = 11.0, 7
    wall: list[tuple[float, ...]] = [(9.0, 2.5)]
    for i in range(turns):
        z = 2.5 + 23.0 * i / turns
        wall += [(radius, z + 0.8, 0.8), (radius, z + 2.3, 0.8), (radius - 1.0, z + 23.0 / turns, 0.3)]
    wall[-1] = (9.0, 25.5)
    drum = round_polyline(wall, step_mm=1.0)
    up = round_polyline([(9.0, 25.5), (6.0, 25.5, 0.3), (5.6, 28.0, 0.6), (2.6, 28.0, 0.3), (2.2, 26.5, 0.3), (0.0, 26.5)], step_mm=1.5)
    down = (up * (1, -1) + (0, 28.0))[::-1]
    bands = [
        ProfileBand(down, "hub_down", 18.0, CLAMP_STEEL, "down"),
        ProfileBand(drum, "hub_side", 2 * np.pi * radius, _print_spring, density=0.4),
        ProfileBand(up, "hub_up", 18.0, CLAMP_STEEL, "up"),
    ]
    return revolve(bands, segments=72), [band.make_panel() for band in bands]


def _print_barrel(canvas: Canvas) -> None:
    width, height = canvas.width_mm, canvas.height_mm
    canvas.fill("#f7f8f8")
    canvas.rectangle(0, height - 9, width, 9, MARKER_GREEN)
    canvas.rectangle(0, 0, width, 4, LinearGradient("#0c6b3c", MARKER_GREEN))
    x = width / 2
    canvas.text(x + 3.4, height / 2 + 6, "SCRIBBAR", 8.6, "#1c2126", "bold", turn=90, max_width=58)
    canvas.text(x + 9.4, height / 2 + 6, "whiteboard 700", 3.6, MARKER_GREEN, "oblique", turn=90, max_width=52)
    canvas.rectangle(x - 8.5, 8, 13, 6.6, MARKER_GREEN, radius=1.2)
    canvas.text(x - 2, 12.6, "GREEN", 2.4, "#ffffff", "bold", max_width=11)
    canvas.polygon([(x - 9, 18), (x - 1, 18), (x + 2, 20), (x - 1, 22), (x - 9, 22)], MARKER_GREEN)
    draw_barcode(canvas, width * 0.79, 62, 11.5, 9, "201177004462")
    words = "dry wipe, low odour. Keep cap on. Store flat. 2 mm bullet tip, refillable. Not for skin."
    draw_paragraph(canvas, width * 0.79, 14, 11.2, words, 1.3, "#1c2126")
    draw_recycling_mark(canvas, width * 0.89, 54, 7, "5", MARKER_GREEN)
    canvas.text(width * 0.12, height / 2, "SCRIBBAR 700  *  made with 60% recycled plastic", 1.8, "#5a6470", "sans", turn=90, max_width=72)
    for i in range(6):
        canvas.rectangle(width * 0.18, 12 + 11 * i, 1.6, 7, ("#118a4e", "#d8232a", "#1c4fa1", "#1c2126", "#f28c1a", "#7a3c9c")[i])


def _print_cap(canvas: Canvas) -> None:
    canvas.fill(MARKER_GREEN)
    for i in range(24):
        canvas.rectangle(canvas.width_mm * i / 24, canvas.height_mm - 16, canvas.width_mm / 60, 14, "#0c6b3c")


def _print_lever(canvas: Canvas, low: np.ndarray) -> None:
    """Seen from above with the jaws towards the reader; `low` is where on the tool (x, y) the sheet's upper left corner lies."""
    canvas.fill(CLAMP_BLACK)

    def engrave(x: float, y: float, words: str, cap: float, font: str, turn: float = 0.0) -> None:
        down = rotate_points([(0.0, cap / 2)], -turn)[0]
        canvas.text(y - low[1] + down[0], x - low[0] + down[1], words, cap, "#f4f4f4", font, turn=turn)

    engrave(16.0, 18.5, "GRIPFOLD", 3.8, "bold", -45.0)
    engrave(38.0, 27.5, "50", 4.6, "bold")
    engrave(-20.0, 7.0, "12 kg", 2.4, "sans")
    engrave(-25.0, 9.0, "MAX", 2.4, "sans")


def _print_grip(canvas: Canvas) -> None:
    canvas.fill(CLAMP_ORANGE)
    canvas.text(canvas.width_mm / 2 + 1.5, canvas.height_mm / 2, "squeeze", 4.4, "#5c2a00", "oblique", turn=-68, max_width=32)


def _print_spring(canvas: Canvas) -> None:
    canvas.fill("#9aa0a6")
    for i in range(7):
        canvas.rectangle(0, canvas.height_mm * (i + 0.3) / 7, canvas.width_mm, canvas.height_mm * 0.06, "#d7dbdf")
