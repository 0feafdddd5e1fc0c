"""A squeezable mustard bottle with shoulders and a nozzle cap."""

import numpy as np

from zeroshop_steps.synthetic.products.assemble import Product
from zeroshop_steps.synthetic.products.canvas import Canvas, LinearGradient, RadialGradient
from zeroshop_steps.synthetic.products.illustrations import draw_leaf
from zeroshop_steps.synthetic.products.printing import draw_badge, draw_barcode, draw_nutrition_table, draw_paragraph, draw_recycling_mark
from zeroshop_steps.synthetic.products.profiles import arc_length, round_polyline, sample_superellipse
from zeroshop_steps.synthetic.products.solids import ProfileBand, revolve

HALF_WIDTH_MM = 47.0
DEPTH_RATIO = 0.61
SHOULDER_Z_MM, NECK_Z_MM = 118.0, 152.0


def mustard_bottle() -> Product:
    """A flattened bottle, 94 x 57 x 191 mm, yellow with a printed front and back and a red cap."""
    wall = round_polyline(
        [
            (41.0, 0.0),
            (46.0, 0.0, 5.0),
            (47.0, 12.0, 20.0),
            (47.0, 112.0, 34.0),
            (39.0, 134.0, 26.0),
            (21.0, 149.0, 14.0),
            (17.5, 152.0, 1.5),
            (17.5, 156.0),
        ],
        step_mm=3.0,
    )
    collar = round_polyline(
        [(17.5, 156.0), (20.5, 156.0, 0.8), (20.5, 169.0, 2.5), (13.0, 174.0, 2.0), (8.0, 176.0, 2.0), (4.5, 189.0, 1.0)], step_mm=2.0
    )
    tip = round_polyline([(4.5, 189.0), (4.0, 191.0, 0.6), (0.0, 191.0)], step_mm=1.0)
    foot = round_polyline([(0.0, 2.0), (34.0, 2.0, 3.0), (37.0, 0.0, 1.0), (41.0, 0.0)], step_mm=3.0)
    girth = arc_length(sample_superellipse(HALF_WIDTH_MM * DEPTH_RATIO, HALF_WIDTH_MM, 2.5, np.linspace(0, 1, 2000), 0.0))[-1]
    bands = [
        ProfileBand(foot, "foot", 2 * HALF_WIDTH_MM, _print_foot, "down", density=0.5),
        ProfileBand(wall, "wall", girth, _print_wall),
        ProfileBand(collar, "cap", 2 * np.pi * 20.5, _print_cap, density=0.5),
        ProfileBand(tip, "tip", 10.0, "#8f1410", "up"),
    ]
    body = revolve(bands, segments=120, seam_rad=-np.pi / 2, section=_section)
    return Product([body], [band.make_panel() for band in bands])


def _section(radius: float, z: float) -> tuple[float, float, float]:
    """Flat and boxy below the shoulder, round at the neck."""
    t = np.clip((z - SHOULDER_Z_MM) / (NECK_Z_MM - SHOULDER_Z_MM), 0, 1)
    t = t * t * (3 - 2 * t)
    return radius * (DEPTH_RATIO + (1 - DEPTH_RATIO) * t), radius, 2.5 - 0.5 * t


def _print_wall(canvas: Canvas) -> None:
    canvas.fill(LinearGradient("#f2b90c", "#f7c81e"))
    front, back = canvas.width_mm * 0.25, canvas.width_mm * 0.75
    _print_front(canvas, front, canvas.height_mm)
    _print_back(canvas, back, canvas.height_mm)


def _print_front(canvas: Canvas, x: float, foot: float) -> None:
    canvas.rectangle(x - 36, foot - 122, 72, 108, LinearGradient("#fffdf2", "#ffeeb0"), radius=12)
    canvas.rectangle(x - 34.5, foot - 120.5, 69, 105, LinearGradient("#a3120f", "#6d0907"), radius=11)
    canvas.rectangle(x - 33, foot - 119, 66, 102, LinearGradient("#fffdf2", "#ffe69a"), radius=10)
    canvas.polygon(
        [(x - 38, foot - 88), (x + 38, foot - 94), (x + 38, foot - 66), (x - 38, foot - 60)], LinearGradient("#c61a14", "#8f0f0b")
    )
    canvas.text(x, foot - 71, "GOLDHALM", 12.5, "#ffffff", "bold", turn=4.5, max_width=68, edge="#4a0503", edge_mm=0.7)
    canvas.text(x, foot - 103, "the mild one", 4.6, "#7a0c08", "script", max_width=44)
    canvas.text(x, foot - 96.5, "EST. 1884", 2.4, "#7a0c08", "bold")
    canvas.text(x, foot - 50, "MUSTARD", 8.8, "#7a0c08", "serif", max_width=56)
    canvas.text(x, foot - 44, "with honey and cider vinegar", 2.7, "#3c2a08", "oblique", max_width=54)
    for i in range(11):
        angle = np.deg2rad(-150 + 12 * i)
        canvas.polygon(
            [(x - 13, foot - 27), *((x - 13 + 12 * np.cos(angle + d), foot - 27 + 12 * np.sin(angle + d)) for d in (-0.06, 0.06))],
            "#f2b90c",
        )
    _flower(canvas, x - 13, foot - 29, 8.0)
    draw_leaf(canvas, x - 12, foot - 24, 11, 25)
    draw_leaf(canvas, x - 14, foot - 24, 11, 155)
    draw_badge(canvas, x + 17, foot - 30, 10, ("NO", "COLOURS", "ADDED"), "#2f7d32", teeth=20)
    canvas.text(x - 14, foot - 8.5, "350 g", 3.6, "#5a3c00", "bold")
    canvas.text(x + 14, foot - 8.5, "12.3 oz", 2.8, "#5a3c00", "sans")


def _flower(canvas: Canvas, x: float, y: float, size: float) -> None:
    for i in range(4):
        angle = np.deg2rad(45 + 90 * i)
        canvas.ellipse(
            x + 0.42 * size * np.cos(angle),
            y + 0.42 * size * np.sin(angle),
            0.46 * size,
            0.36 * size,
            RadialGradient("#fff27a", "#e8a800"),
            turn=45 + 90 * i,
        )
    canvas.ellipse(x, y, 0.2 * size, 0.2 * size, RadialGradient("#d9e86a", "#6f8f1a"))


def _print_back(canvas: Canvas, x: float, foot: float) -> None:
    canvas.rectangle(x - 35, foot - 120, 70, 106, "#fffbe8", radius=10)
    canvas.text(x, foot - 110, "Goldhalm mild mustard", 3.8, "#8f0f0b", "bold", max_width=62)
    story = (
        "Stone-ground brown and yellow seed from our own fields, rested for a fortnight in oak. "
        "Good with sausages, in a dressing, or straight on bread."
    )
    draw_paragraph(canvas, x - 31, foot - 106, 62, story, 2.1, "#3c2a08")
    rows = (
        ("Energy", "640 kJ"),
        ("Fat", "7.9 g"),
        (" saturates", "0.5 g"),
        ("Carbohydrate", "13 g"),
        (" sugars", "11 g"),
        ("Protein", "5.4 g"),
        ("Salt", "2.3 g"),
    )
    draw_nutrition_table(canvas, x - 31, foot - 87, 30, rows, cap=1.6)
    words = (
        "INGREDIENTS: water, mustard seed (24%), honey (9%), cider vinegar, sugar, salt, turmeric, paprika, garlic, spices. "
        "ALLERGEN: MUSTARD. Shake well. Keep in the refrigerator after opening and use within two months."
    )
    draw_paragraph(canvas, x + 2, foot - 87, 29, words, 1.5, "#3c2a08")
    draw_barcode(canvas, x - 31, foot - 50, 38, 26, "209884035071")
    draw_recycling_mark(canvas, x + 20, foot - 40, 11, "2", "#2f7d32")
    canvas.text(x + 20, foot - 28, "HDPE", 2.4, "#2f7d32")
    canvas.text(x, foot - 18, "Best before: see shoulder   L 4471 B", 2.0, "#3c2a08", "mono", max_width=60)
    canvas.text(x, foot - 126, "BB 05/2031", 2.6, "#6a4a00", "mono")


def _print_cap(canvas: Canvas) -> None:
    canvas.fill(LinearGradient("#a81812", "#c9221b"))
    for i in range(60):
        x = canvas.width_mm * i / 60
        canvas.rectangle(x, canvas.height_mm - 14.5, canvas.width_mm / 130, 11, "#8f1410")


def _print_foot(canvas: Canvas) -> None:
    canvas.fill("#e5ad08")
    draw_recycling_mark(canvas, canvas.width_mm / 2, canvas.height_mm / 2, 12, "2", "#b98905")
    canvas.text(canvas.width_mm / 2, canvas.height_mm / 2 + 12, "GH 350-2", 2.6, "#b98905", "bold")
