"""A toothpaste tube that stands on its cap: round below, crimped flat above."""

import numpy as np

from zeroshop_steps.synthetic.products.assemble import Product
from zeroshop_steps.synthetic.products.canvas import Canvas, LinearGradient, RadialGradient
from zeroshop_steps.synthetic.products.illustrations import draw_leaf
from zeroshop_steps.synthetic.products.printing import draw_badge, draw_barcode, draw_paragraph, draw_recycling_mark
from zeroshop_steps.synthetic.products.profiles import round_polyline
from zeroshop_steps.synthetic.products.solids import ProfileBand, revolve

RADIUS_MM = 19.0
ROUND_Z_MM, CRIMP_Z_MM, TOP_Z_MM = 34.0, 150.0, 162.0


def toothpaste_tube() -> Product:
    """A tube 162 mm high, 38 mm round at the cap and 60 mm wide at the crimp."""
    cap = round_polyline([(13.0, 0.0), (16.5, 0.0, 1.5), (17.2, 22.0, 1.5), (13.5, 24.0)], step_mm=2.0)
    shoulder = round_polyline([(13.5, 24.0), (13.5, 25.5, 0.5), (19.0, 29.0, 1.5), (19.0, ROUND_Z_MM)], step_mm=1.5)
    wall = round_polyline([(RADIUS_MM, ROUND_Z_MM), (RADIUS_MM, CRIMP_Z_MM)], step_mm=2.5)
    crimp = round_polyline([(RADIUS_MM, CRIMP_Z_MM), (RADIUS_MM, TOP_Z_MM)], step_mm=1.5)
    seam = np.array([(RADIUS_MM, TOP_Z_MM), (RADIUS_MM * 0.5, TOP_Z_MM), (0.0, TOP_Z_MM)])
    foot = round_polyline([(0.0, 0.8), (12.0, 0.8, 0.4), (13.0, 0.0)], step_mm=3.0)
    girth = 2 * np.pi * RADIUS_MM
    bands = [
        ProfileBand(foot, "foot", 26.0, "#e9edf0", "down"),
        ProfileBand(cap, "cap", girth, _print_cap, density=0.7),
        ProfileBand(shoulder, "shoulder", girth, "#eef3f5"),
        ProfileBand(wall, "wall", girth, _print_wall),
        ProfileBand(crimp, "crimp", girth, _print_crimp),
        ProfileBand(seam, "seam", 62.0, "#0b6e8f", "up"),
    ]
    body = revolve(bands, segments=128, seam_rad=-np.pi / 2, section=_section)
    return Product([body], [band.make_panel() for band in bands])


def _section(radius: float, z: float) -> tuple[float, float, float]:
    """Ellipses of one girth, from a circle at the shoulder to a flat crimp; smaller ones are scaled."""
    t = np.clip((z - ROUND_Z_MM) / (CRIMP_Z_MM - ROUND_Z_MM), 0, 1)
    if t == 0:
        return radius, radius, 2.0
    half_x = RADIUS_MM + (0.7 - RADIUS_MM) * float(t) ** 1.15
    low, high = RADIUS_MM, 1.6 * RADIUS_MM
    for _ in range(50):
        half_y = (low + high) / 2
        shape = ((half_x - half_y) / (half_x + half_y)) ** 2
        girth = np.pi * (half_x + half_y) * (1 + 3 * shape / (10 + np.sqrt(4 - 3 * shape)))  # Ramanujan 1914
        low, high = (half_y, high) if girth < 2 * np.pi * RADIUS_MM else (low, half_y)
    scale = radius / RADIUS_MM
    return half_x * scale, half_y * scale, 2.0


def _print_wall(canvas: Canvas) -> None:
    width = canvas.width_mm
    canvas.fill(LinearGradient("#0b6e8f", "#e8f7fa"))
    x = width * 0.25
    swoosh = [(x - 34, 62), (x - 18, 50), (x, 45), (x + 34, 50), (x + 34, 57), (x, 53), (x - 16, 58), (x - 34, 72)]
    canvas.polygon(swoosh, LinearGradient("#ffffff", "#9fdfe8", horizontal=True))
    canvas.text(x, 22, "Pearlumo", 9.0, "#ffffff", "oblique", max_width=50, edge="#06465c", edge_mm=0.5)
    canvas.text(x, 31, "FRESH MINT", 4.2, "#d8fff0", "bold", max_width=46)
    canvas.text(x, 38, "fluoride toothpaste", 2.6, "#ffffff", "sans", max_width=44)
    canvas.ellipse(x - 9, 76, 12, 12, RadialGradient("#2fb3c9", "#0b6e8f"))
    canvas.ring(x - 9, 76, 11, 0.5, "#ffffff")
    _smile(canvas, x - 9, 75, 14)
    for turn in (-100, -55, -10):
        draw_leaf(canvas, x + 10, 74, 13, turn, "#8be0a4", "#14804a")
    draw_badge(canvas, x + 10, 86, 8, ("24 h", "CLEAN"), RadialGradient("#ffb52e", "#e07a00"), teeth=16)
    canvas.text(x, 103, "75 ml e", 3.8, "#06465c", "bold", max_width=30)
    canvas.line([(x - 20, 106), (x + 20, 106)], 0.8, "#0b6e8f")
    canvas.text(x, 112, "enamel care for every day", 2.0, "#06465c", "sans", max_width=36)
    back = width * 0.75
    canvas.text(back, 16, "Pearlumo", 5.6, "#ffffff", "oblique", max_width=46)
    use = "Directions: brush twice a day for two minutes. Children under seven: a pea-sized amount under supervision. Do not swallow."
    below = draw_paragraph(canvas, back - 22, 20, 44, use, 2.0, "#ffffff")
    words = (
        "Ingredients: aqua, hydrated silica, sorbitol, glycerin, sodium lauryl sulfate, xanthan gum, mentha piperita oil, "
        "sodium saccharin, sodium fluoride (1450 ppm F), limonene, CI 77891."
    )
    draw_paragraph(canvas, back - 22, max(below + 2, 60), 44, words, 1.6, "#06303f")
    draw_barcode(canvas, back - 22, 84, 30, 20, "208876540129")
    draw_recycling_mark(canvas, back + 16, 92, 9, "7", "#0b6e8f")
    canvas.text(back, 112, "LOT 5 22 09  EXP 04/33", 2.0, "#06465c", "mono", max_width=44)


def _smile(canvas: Canvas, x: float, y: float, size: float) -> None:
    """A tooth with a glint."""
    t = np.linspace(0, np.pi, 30)
    crown = np.stack([x - size * 0.42 * np.cos(t), y - size * 0.36 * np.sin(t) ** 0.7], 1)
    roots = [(x + 0.4 * size, y + 0.15 * size), (x + 0.26 * size, y + 0.5 * size), (x + 0.1 * size, y + 0.2 * size)]
    roots += [(x - 0.1 * size, y + 0.2 * size), (x - 0.26 * size, y + 0.5 * size), (x - 0.4 * size, y + 0.15 * size)]
    canvas.polygon(np.concatenate([crown, roots]) + (0.4, 0.6), "#06465c", 0.35, 0.5)
    canvas.polygon(np.concatenate([crown, roots]), RadialGradient("#ffffff", "#bfe6ee", (0.4, 0.3), 1.5))
    glint = [(0, -1), (0.16, -0.16), (1, 0), (0.16, 0.16), (0, 1), (-0.16, 0.16), (-1, 0), (-0.16, -0.16)]
    canvas.polygon(np.array(glint) * size * 0.24 + (x + size * 0.4, y - size * 0.32), "#ffffff")


def _print_cap(canvas: Canvas) -> None:
    canvas.fill("#f4f7f8")
    for i in range(48):
        canvas.rectangle(canvas.width_mm * i / 48, 4, canvas.width_mm / 110, canvas.height_mm - 10, LinearGradient("#c3ced4", "#aebbc2"))


def _print_crimp(canvas: Canvas) -> None:
    canvas.fill("#0b6e8f")
    for i in range(5):
        canvas.line([(0, 1.6 + 2.1 * i), (canvas.width_mm, 1.6 + 2.1 * i)], 0.4, "#3c9ab5")
    for x in (canvas.width_mm * 0.25, canvas.width_mm * 0.75):
        canvas.rectangle(x - 14, 3.4, 28, 5.2, "#0b6e8f")
        canvas.text(x, 7.4, "5 22 09  04/33", 2.2, "#d8fff0", "mono")
