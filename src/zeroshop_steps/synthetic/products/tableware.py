"""Open vessels with a wall of a few millimetres: a pitcher, a mug and a plain bowl."""

from dataclasses import replace

import numpy as np

from zeroshop_steps.synthetic.products.assemble import Product
from zeroshop_steps.synthetic.products.canvas import Canvas, LinearGradient, RadialGradient
from zeroshop_steps.synthetic.products.illustrations import draw_citrus_slice, draw_leaf
from zeroshop_steps.synthetic.products.panels import make_plain_panel
from zeroshop_steps.synthetic.products.printing import draw_recycling_mark
from zeroshop_steps.synthetic.products.profiles import arc_length, round_polyline
from zeroshop_steps.synthetic.products.solids import ProfileBand, Solid, revolve, sweep_rod

BOWL_RED = "#b8442f"
PITCHER_BLUE, PITCHER_DARK = "#5fa8cf", "#3b83ad"
MUG_CREAM, MUG_TEAL = "#f6efe0", "#1f7f86"


def pitcher() -> Product:
    """A water jug of 216 mm height with a spout on the right, a handle on the left and a measuring scale."""
    outside = round_polyline([(50.0, 0.0), (52.0, 0.0, 1.8), (52.5, 30.0), (58.0, 213.0)], step_mm=4.0)
    inside = round_polyline(
        [(58.0, 213.0), (58.2, 216.0, 1.4), (55.2, 216.0, 1.4), (54.8, 200.0), (49.5, 5.0, 10.0), (30.0, 5.0)], step_mm=4.0
    )
    floor = round_polyline([(30.0, 5.0), (0.0, 5.0)], step_mm=5.0)
    foot = round_polyline([(0.0, 2.0), (44.0, 2.0, 1.0), (46.0, 0.0, 0.8), (50.0, 0.0)], step_mm=5.0)
    girth = 2 * np.pi * 56.0
    bands = [
        ProfileBand(foot, "foot", 104.0, _print_pitcher_foot, "down", density=0.4),
        ProfileBand(outside, "outside", girth, _print_pitcher),
        ProfileBand(inside, "inside", girth, PITCHER_DARK),
        ProfileBand(floor, "floor", 60.0, PITCHER_DARK, "up"),
    ]
    body = _add_spout(revolve(bands, segments=108))
    path = round_polyline([(-55.2, 182.0), (-98.0, 184.0, 24.0), (-92.0, 78.0, 26.0), (-51.7, 62.0)], step_mm=3.0)
    handle, girth_mm = _make_handle(path, 5.5, 9.0, "handle")
    grip = make_plain_panel("handle", girth_mm, float(arc_length(path)[-1]), "#f1f4f6")
    return Product([body, handle], [*(band.make_panel() for band in bands), grip])


def mug() -> Product:
    """A coffee mug of 82 mm diameter and 96 mm height with a landscape around it and a handle on the right."""
    outside = round_polyline([(32.0, 0.0), (34.0, 0.0, 0.8), (35.0, 3.0, 1.0), (41.0, 9.0, 8.0), (41.0, 93.0)], step_mm=3.0)
    inside = round_polyline([(41.0, 93.0), (41.0, 96.0, 1.8), (37.0, 96.0, 1.8), (37.0, 6.0, 9.0), (22.0, 6.0)], step_mm=3.0)
    floor = round_polyline([(22.0, 6.0), (0.0, 6.0)], step_mm=4.0)
    foot = round_polyline([(0.0, 2.0), (28.0, 2.0, 1.0), (30.0, 0.0, 0.8), (32.0, 0.0)], step_mm=4.0)
    girth = 2 * np.pi * 41.0
    bands = [
        ProfileBand(foot, "foot", 68.0, _print_mug_foot, "down", density=0.5),
        ProfileBand(outside, "outside", girth, _print_mug),
        ProfileBand(inside, "inside", girth, MUG_TEAL),
        ProfileBand(floor, "floor", 44.0, MUG_TEAL, "up"),
    ]
    body = revolve(bands, segments=144, seam_rad=np.pi / 2)
    path = round_polyline([(39.2, 78.0), (70.0, 80.0, 19.0), (68.0, 26.0, 22.0), (39.2, 22.0)], step_mm=2.5)
    handle, girth_mm = _make_handle(path, 4.2, 6.5, "handle")
    grip = make_plain_panel("handle", girth_mm, float(arc_length(path)[-1]), MUG_TEAL)
    return Product([body, handle], [*(band.make_panel() for band in bands), grip])


def bowl() -> Product:
    """A bowl of 160 mm diameter, 56 mm high, of one colour and the same from all sides."""
    angle = np.linspace(0.0, np.pi / 2, 40)
    outside = np.column_stack([36.0 + 44.0 * np.sin(angle) ** 0.9, 4.0 + 50.2 * (1 - np.cos(angle)) ** 0.85])
    inside = np.column_stack([76.6 * np.cos(angle) ** 0.75, 54.2 - 46.6 * np.sin(angle) ** 1.1])
    foot = round_polyline([(0.0, 3.0), (30.0, 3.0, 1.0), (31.5, 0.0, 0.6), (35.0, 0.0, 1.0), (36.0, 4.0)], step_mm=4.0)
    lip_angle = np.linspace(0, np.pi, 12)
    lip = np.column_stack([78.3 + 1.7 * np.cos(lip_angle), 54.2 + 1.7 * np.sin(lip_angle)])
    girth = 2 * np.pi * 80.0
    bands = [
        ProfileBand(foot, "foot", 72.0, BOWL_RED, "down"),
        ProfileBand(outside, "outside", girth, BOWL_RED),
        ProfileBand(lip, "lip", girth, BOWL_RED),
        ProfileBand(inside, "inside", 154.0, BOWL_RED, "up"),
    ]
    return Product([revolve(bands, segments=144)], [band.make_panel() for band in bands], turns_about_z=True)


def _make_handle(path_yz: np.ndarray, half_out: float, half_side: float, panel: str) -> tuple[Solid, float]:
    """A handle along a path in the y-z plane, thicker at its ends; also the width that its panel needs."""
    path = np.column_stack([np.zeros(len(path_yz)), path_yz])
    along = arc_length(path) / arc_length(path)[-1]
    swell = 1 + 0.28 * np.abs(2 * along - 1) ** 6
    solid = sweep_rod(path, np.array([1.0, 0.0, 0.0]), half_out * swell, half_side * np.minimum(swell, 1.15), panel)
    return solid, np.pi * float(np.max(half_out * swell + half_side * np.minimum(swell, 1.15)))


def _add_spout(body: Solid) -> Solid:
    """Draw the rim out towards +y, as far down as a hand's breadth."""
    moved = []
    for patch in body:
        x, y, z = patch.vertices.T
        direction = np.arctan2(x, y)
        reach = np.clip((z - 150.0) / 66.0, 0, 1) ** 2.2 * np.exp(-((direction / 0.32) ** 2))
        radius = np.hypot(x, y)
        factor = 1 + 17.0 * reach * (radius > 40.0) / np.maximum(radius, 1e-9)
        moved.append(replace(patch, vertices=np.column_stack([x * factor, y * factor, z])))
    return moved


def _print_pitcher(canvas: Canvas) -> None:
    width, height = canvas.width_mm, canvas.height_mm
    canvas.fill(LinearGradient("#7fc0e2", PITCHER_BLUE))
    canvas.rectangle(0, height - 26, width, 26, LinearGradient(PITCHER_BLUE, PITCHER_DARK))
    x = width / 2
    canvas.ellipse(x, 88, 47, 44, RadialGradient("#ffffff", "#dff1fa", (0.5, 0.5), 1.0))
    canvas.ring(x, 88, 41, 0.9, PITCHER_DARK)
    draw_citrus_slice(canvas, x - 14, 105, 16)
    draw_citrus_slice(canvas, x + 16, 110, 12, "#8bc34a", "#dcedc8")
    draw_leaf(canvas, x + 5, 102, 20, -30)
    draw_leaf(canvas, x + 3, 101, 17, -75)
    canvas.text(x, 88, "Aquillo", 15, "#1c5f88", "script", max_width=72)
    canvas.text(x, 70, "COLD & CLEAR", 4.4, "#1c5f88", "bold")
    canvas.text(x, 62, "since the first summer", 2.4, "#3b83ad", "oblique")
    random = np.random.default_rng(11)
    for at, level, size in zip(random.uniform(0, width, 90), random.uniform(0, 1, 90), random.uniform(1.2, 4.2, 90), strict=True):
        if abs(at - x) < 84 and abs(at - x) > 48 or size > 3.6 and abs(at - x) < 52:
            continue  # room for the scale and the label
        y = height - 32 - 120 * level**1.6
        if abs(at - x) > 52 or y > 140:
            canvas.ring(at, y, size, 0.5, "#ffffff", 0.9)
            canvas.ellipse(at - 0.35 * size, y - 0.35 * size, 0.22 * size, 0.16 * size, "#ffffff", 0.9)
    canvas.text(x, height - 12, "1.8 litre  *  dishwasher safe", 4.2, "#ffffff", "bold", max_width=96)
    for i in range(1, 8):
        y = height - 22 - 22.5 * i
        major = i % 2 == 0
        for side in (-1, 1):
            at = x + side * 76
            canvas.line([(at, y), (at - side * (14 if major else 8), y)], 0.9, "#ffffff")
            if major:
                canvas.text(at - side * 22, y + 2, f"{i // 2 * 0.5:.1f} l" if side > 0 else f"{i // 2 * 500} ml", 3.6, "#ffffff", "bold")
    for back in (0.0, width):  # the two halves meet at the back
        canvas.text(back, 90, "Aquillo", 12, "#ffffff", "script")
        canvas.text(back, 99, "fill  *  pour  *  repeat", 3.4, "#dff1fa", "oblique")


def _print_pitcher_foot(canvas: Canvas) -> None:
    canvas.fill(PITCHER_DARK)
    draw_recycling_mark(canvas, 52, 46, 16, "5", "#8fc7e4")
    canvas.text(52, 66, "PP  AQUILLO 1.8", 4.0, "#8fc7e4", "bold")


def _print_mug(canvas: Canvas) -> None:
    width, height = canvas.width_mm, canvas.height_mm
    canvas.fill(MUG_CREAM)
    canvas.rectangle(0, 16, width, height - 30, LinearGradient("#ffd9a0", "#f7a072"))
    sun = width * 0.25
    for i in range(24):
        angle = 2 * np.pi * i / 24
        ray = [(sun + 19 * np.cos(angle + d), 50 + 19 * np.sin(angle + d)) for d in (-0.05, 0.05)]
        canvas.polygon([*ray, (sun + 28 * np.cos(angle), 50 + 28 * np.sin(angle))], "#fff0c2", 0.8)
    canvas.ellipse(sun, 50, 17, 17, RadialGradient("#fff6cf", "#f9c22e", (0.5, 0.5), 1.1))
    t = np.linspace(0, 1, 500)
    ranges = (("#b56576", 62, (5, 2), 0.0), ("#6d597a", 70, (4, 7), 1.9), ("#355070", 78, (3, 5), 4.1))
    for colour, level, counts, phase in ranges:
        waves = [5.0 / (k + 1) * np.sin(2 * np.pi * count * t + phase * (k + 1)) for k, count in enumerate(counts)]
        ridge = level + sum(waves, np.zeros_like(t))
        canvas.polygon([*zip(t * width, ridge, strict=True), (width, height - 14), (0, height - 14)], colour)
    random = np.random.default_rng(7)
    for x, size in zip(np.linspace(3, width - 5, 30) + random.uniform(-2, 2, 30), random.uniform(5, 10, 30), strict=True):
        for k in range(3):
            y = height - 14 - size * 0.32 * k
            canvas.polygon([(x - size * (0.32 - 0.07 * k), y), (x + size * (0.32 - 0.07 * k), y), (x, y - size * 0.5)], "#1d3a4a")
    for start in (0.52, 0.6, 0.9):
        for i in range(3):
            x, y = width * start + 7 * i, 30 + 5 * (i % 2)
            canvas.line([(x - 3, y - 1.6), (x, y), (x + 3, y - 1.6)], 0.5, "#355070")
    canvas.rectangle(0, 14.6, width, 1.4, MUG_TEAL)
    canvas.rectangle(0, height - 14, width, 1.4, MUG_TEAL)
    canvas.text(width * 0.25, 12, "good morning", 6.4, MUG_TEAL, "script")
    canvas.text(width * 0.75, 12, "one more cup", 6.0, "#b56576", "script")
    canvas.text(width * 0.75, 50, "FELLBROOK", 8.5, "#fffaf0", "bold", max_width=64, edge="#6d597a", edge_mm=0.7)
    canvas.text(width * 0.75, 57, "mountain hut roastery 1764 m", 2.6, "#6d597a", "bold", max_width=60)


def _print_mug_foot(canvas: Canvas) -> None:
    canvas.fill("#e9dfca")
    canvas.text(34, 32, "FELLBROOK", 3.6, "#8a7a5c", "bold")
    canvas.text(34, 39, "stoneware 0.35 l", 2.6, "#8a7a5c", "sans")
