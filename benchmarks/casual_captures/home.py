"""Things at home: an apple, a tissue box, a black computer mouse, a white vase, a plant in a pot, and a desk lamp."""

from dataclasses import replace

import numpy as np

from casual_captures.bodies import make_ellipsoid, make_mottled_panel, make_rod, make_turned
from zeroshop_steps.synthetic.products.assemble import Product
from zeroshop_steps.synthetic.products.canvas import Canvas
from zeroshop_steps.synthetic.products.illustrations import draw_leaf
from zeroshop_steps.synthetic.products.panels import Panel
from zeroshop_steps.synthetic.products.solids import make_rounded_box, transform_solid

SIDE_MM = 80.0  # of the panels


def apple() -> Product:
    """A red and yellow apple of 80 mm with a stalk."""
    outline = [(0, 9), (10, 4, 6), (20, 0, 6), (34, 12, 18), (40, 38, 24), (34, 66, 20), (18, 72, 10), (7, 66, 6), (0, 60)]
    stalk = make_rod((0, 0, 58), (5, 3, 80), 1.8, "stalk", SIDE_MM, 1.4)
    panels = [
        make_mottled_panel("skin", SIDE_MM, "#b3281e", 30, 0.16, _draw_apple),
        make_mottled_panel("stalk", SIDE_MM, "#5a4126", 31, 0.2),
    ]
    return Product([make_turned(outline, "skin", SIDE_MM), stalk], panels)


def _draw_apple(canvas: Canvas) -> None:
    rng = np.random.default_rng(32)
    for x in rng.uniform(0, SIDE_MM, 60):
        canvas.line([(x, 4.0), (x + rng.normal(0, 2), SIDE_MM - 6)], float(rng.uniform(0.3, 1.6)), "#d9a33b", float(rng.uniform(0.1, 0.45)))
    for x, y in rng.uniform(0, SIDE_MM, (160, 2)):
        canvas.ellipse(x, y, 0.35, 0.35, "#e8d39a", 0.8)


def tissue_box() -> Product:
    """A printed box of 230 x 120 x 85 mm with a white tissue that stands out of it."""
    size = (120.0, 230.0, 85.0)
    box = transform_solid(make_rounded_box(size, 2.0, 10.0), np.eye(3), (0, 0, size[2] / 2))
    sides = {"front": (230, 85), "back": (230, 85), "left": (120, 85), "right": (120, 85), "top": (230, 120), "bottom": (230, 120)}
    printed = [Panel(name, float(width), float(height), _draw_box) for name, (width, height) in sides.items()]
    folds = [((0, 0, 84), (9, 46, 26), 0.0), ((4, 14, 98), (7, 30, 32), 24.0), ((-4, -16, 96), (6, 26, 30), -28.0)]
    tissue = [make_ellipsoid(centre, half, "tissue", SIDE_MM, (turn, 0, turn / 2)) for centre, half, turn in folds]
    return Product([box, *tissue], [*printed, make_mottled_panel("tissue", SIDE_MM, "#efeeec", 33, 0.05)])


def _draw_box(canvas: Canvas) -> None:
    rng = np.random.default_rng(int(canvas.width_mm))
    canvas.fill("#cfdcd8")
    for x, y in rng.uniform(0, 1, (26, 2)) * [canvas.width_mm, canvas.height_mm]:
        draw_leaf(canvas, float(x), float(y), float(rng.uniform(14, 34)), float(rng.uniform(0, 360)), "#7da38c", "#3f6a5a")


def computer_mouse() -> Product:
    """A black mouse of 115 mm, nearly without texture, with a grey wheel."""
    rounded = [
        make_ellipsoid((0, 0, 8), (58, 31, 30), "black", SIDE_MM),
        make_ellipsoid((-14, 0, 10), (42, 33, 30), "black", SIDE_MM),
        make_ellipsoid((20, 0, 6), (38, 30, 22), "black", SIDE_MM),
    ]
    # Flat below, each a little higher than the last: bodies whose faces lie in one plane cannot be joined exactly.
    shell = [
        [replace(patch, vertices=np.maximum(patch.vertices, [-np.inf, -np.inf, 0.4 * index])) for patch in solid]
        for index, solid in enumerate(rounded)
    ]
    wheel = make_ellipsoid((34, 0, 25), (9, 3.5, 7), "grey", SIDE_MM)
    panels = [make_mottled_panel("black", SIDE_MM, "#2a2a2d", 34, 0.05), make_mottled_panel("grey", SIDE_MM, "#77777c", 35, 0.1)]
    return Product([*shell, wheel], panels)


def white_vase() -> Product:
    """A plain white vase of 190 mm, closed at the top by a dark opening."""
    body = [(0, 0), (34, 0, 3), (40, 8, 6), (58, 70, 40), (40, 130, 30), (22, 160, 20), (30, 190, 3), (24, 190, 2), (18, 160, 10), (0, 150)]
    return Product([make_turned(body, "glaze", SIDE_MM)], [make_mottled_panel("glaze", SIDE_MM, "#e6e5e1", 36, 0.03)])


def potted_plant() -> Product:
    """A plant of 200 mm with thin stalks and narrow leaves in a clay pot."""
    pot = make_turned([(0, 0), (30, 0, 2), (40, 62, 1), (44, 62, 2), (44, 74, 2), (38, 74, 1), (36, 66, 2), (0, 66)], "pot", SIDE_MM)
    rng = np.random.default_rng(37)
    green = []
    for index in range(9):
        azimuth, lean = 2 * np.pi * (index + 0.3 * rng.normal()) / 9, rng.uniform(16, 62)
        foot = (9 * np.cos(azimuth), 9 * np.sin(azimuth), 60.0)
        tip = (float(lean * np.cos(azimuth)), float(lean * np.sin(azimuth)), float(rng.uniform(120, 180)))
        green.append(make_rod(foot, tip, 1.9, "stalk", SIDE_MM, 1.5))
        turn = (0.0, float(rng.uniform(-50, 10)), float(np.degrees(azimuth)))
        green.append(make_ellipsoid(tip, (26, 8, 1.8), "leaf", SIDE_MM, turn))
    panels = [
        make_mottled_panel("pot", SIDE_MM, "#b5623f", 38, 0.15),
        make_mottled_panel("stalk", SIDE_MM, "#5d7a36", 39, 0.15),
        make_mottled_panel("leaf", SIDE_MM, "#3f7a35", 40, 0.25),
    ]
    return Product([pot, *green], panels)


def desk_lamp() -> Product:
    """A lamp of 260 mm: a foot, two thin arms at an angle and a shade."""
    foot = make_turned([(0, 0), (55, 0, 2), (55, 8, 4), (14, 16, 6), (0, 18)], "metal", SIDE_MM)
    arms = [make_rod((0, 0, 12), (-46, 0, 128), 4.0, "metal", SIDE_MM), make_rod((-46, 0, 128), (38, 0, 226), 3.6, "metal", SIDE_MM)]
    knee = make_ellipsoid((-46, 0, 128), (8, 7, 8), "joint", SIDE_MM)
    shade = transform_solid(make_turned([(0, 0), (40, 0, 2), (18, 48, 8), (12, 62, 4), (0, 64)], "shade", SIDE_MM), _TILT, (52, 0, 198))
    panels = [
        make_mottled_panel("metal", SIDE_MM, "#8d9096", 41, 0.06),
        make_mottled_panel("joint", SIDE_MM, "#2d2d30", 42, 0.1),
        make_mottled_panel("shade", SIDE_MM, "#3d6a78", 43, 0.06),
    ]
    return Product([foot, *arms, knee, shade], panels)


_TILT = np.array([[np.cos(0.45), 0.0, -np.sin(0.45)], [0.0, 1.0, 0.0], [np.sin(0.45), 0.0, np.cos(0.45)]])
