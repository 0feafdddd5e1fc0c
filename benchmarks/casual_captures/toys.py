"""Toys: a rubber duck, a teddy bear, a thin figure on a block, and a chair for dolls."""

import numpy as np

from casual_captures.bodies import make_ellipsoid, make_mottled_panel, make_rod, make_turned
from zeroshop_steps.synthetic.products.assemble import Product
from zeroshop_steps.synthetic.products.canvas import Canvas
from zeroshop_steps.synthetic.products.solids import Solid, make_rounded_box, transform_solid

SIDE_MM = 60.0  # of the panels


def rubber_duck() -> Product:
    """A yellow duck of 90 mm with an orange beak, eyes, wings and a black hat."""
    body = [
        make_ellipsoid((0, 0, 32), (46, 34, 32), "yellow", SIDE_MM),
        make_ellipsoid((-40, 0, 46), (20, 14, 10), "yellow", SIDE_MM, (0, 35, 0)),
        make_ellipsoid((22, 0, 74), (26, 25, 25), "yellow", SIDE_MM),
        make_ellipsoid((-4, 30, 36), (26, 9, 17), "yellow", SIDE_MM, (0, 15, 0)),
        make_ellipsoid((-4, -30, 36), (26, 9, 17), "yellow", SIDE_MM, (0, 15, 0)),
    ]
    beak = [make_ellipsoid((48, 0, 72), (14, 13, 4), "orange", SIDE_MM), make_ellipsoid((46, 0, 67), (11, 10, 3), "orange", SIDE_MM)]
    eyes = [make_ellipsoid((41, side * 13, 82), (4.5, 4.5, 6), "black", SIDE_MM) for side in (-1, 1)]
    hat = [make_turned([(0, 92), (27, 92, 1), (27, 95, 1), (18, 96, 1), (16, 114, 2), (0, 115)], "black", SIDE_MM, (20, 0, 0))]
    panels = [
        make_mottled_panel("yellow", SIDE_MM, "#f2c316", 1, 0.05),
        make_mottled_panel("orange", SIDE_MM, "#dd6a1a", 2, 0.06),
        make_mottled_panel("black", SIDE_MM, "#26262a", 3, 0.1),
    ]
    return Product([*body, *beak, *eyes, *hat], panels)


def teddy() -> Product:
    """A sitting bear of 190 mm with brown plush, pale paws and a red bow."""
    plush: list[Solid] = [
        make_ellipsoid((0, 0, 62), (50, 52, 62), "plush", SIDE_MM),
        make_ellipsoid((6, 0, 146), (42, 45, 41), "plush", SIDE_MM),
    ]
    pale = [make_ellipsoid((44, 0, 138), (18, 20, 15), "pale", SIDE_MM), make_ellipsoid((38, 0, 62), (16, 30, 38), "pale", SIDE_MM)]
    for side in (-1, 1):
        plush.append(make_ellipsoid((0, side * 36, 182), (10, 17, 17), "plush", SIDE_MM))
        plush.append(make_ellipsoid((18, side * 58, 84), (40, 17, 18), "plush", SIDE_MM, (0, 28, 25.0 * side)))
        plush.append(make_ellipsoid((56, side * 34, 22), (48, 22, 22), "plush", SIDE_MM, (0, 0, 18.0 * side)))
        pale.append(make_ellipsoid((102, side * 49, 24), (8, 18, 20), "pale", SIDE_MM, (0, 0, 18.0 * side)))
    dark = [make_ellipsoid((61, 0, 145), (6, 8, 6), "dark", SIDE_MM)]
    dark += [make_ellipsoid((43, side * 16, 158), (4, 4, 4), "dark", SIDE_MM) for side in (-1, 1)]
    bow = [make_ellipsoid((46, side * 15, 106), (7, 16, 10), "red", SIDE_MM, (12.0 * side, 0, 0)) for side in (-1, 1)]
    panels = [
        make_mottled_panel("plush", SIDE_MM, "#8a5a34", 4, 0.35),
        make_mottled_panel("pale", SIDE_MM, "#cfae82", 5, 0.25),
        make_mottled_panel("dark", SIDE_MM, "#201a18", 6, 0.1),
        make_mottled_panel("red", SIDE_MM, "#a8262b", 7, 0.15),
    ]
    return Product([*plush, *pale, *dark, *bow], panels)


def thin_figure() -> Product:
    """A figure of 180 mm with arms and legs of 6 to 9 mm, which balances on a wooden block."""
    block = transform_solid(make_rounded_box((70.0, 60.0, 30.0), 2.0, 8.0), np.eye(3), (0, 0, 15))
    skin = [make_ellipsoid((0, 0, 166), (11, 10, 13), "clay", SIDE_MM), make_ellipsoid((0, 0, 116), (13, 18, 34), "clay", SIDE_MM)]
    joints = [
        ((0, -5, 90), (4, -9, 28), 5.5, 3.6), ((0, 6, 90), (-24, 10, 62), 5.5, 4.2), ((-24, 10, 62), (-40, 9, 88), 4.2, 3.0),
        ((0, 14, 140), (22, 46, 150), 4.2, 3.4), ((22, 46, 150), (38, 62, 184), 3.4, 2.6),
        ((0, -14, 140), (14, -44, 132), 4.2, 3.4), ((14, -44, 132), (46, -58, 122), 3.4, 2.6), ((0, 0, 146), (0, 0, 160), 5.0, 5.0),
    ]  # fmt: skip
    limbs = [make_rod(start, end, thick, "clay", SIDE_MM, thin) for start, end, thick, thin in joints]
    ends = [end for _, end, _, _ in joints[:-1]]
    knobs = [make_ellipsoid(end, (4.6, 4.6, 4.6), "clay", SIDE_MM) for end in ends]
    foot = [make_ellipsoid((9, -9, 31), (13, 6, 4), "clay", SIDE_MM)]
    sides = {"front": (60, 30), "back": (60, 30), "left": (70, 30), "right": (70, 30), "top": (60, 70), "bottom": (60, 70)}
    panels = [make_mottled_panel("clay", SIDE_MM, "#b9764a", 8, 0.12)]
    panels += [make_mottled_panel(name, float(max(size)), "#a9794a", 9 + index, 0.2) for index, (name, size) in enumerate(sides.items())]
    return Product([block, *skin, *limbs, *knobs, *foot], panels)


def doll_chair() -> Product:
    """A wooden chair of 150 mm: thin legs, a back of three bars, and a seat with a checked cushion."""
    legs = [make_rod((x, y, 0), (x, y, 72), 4.0, "wood", SIDE_MM, 4.8) for x, y in ((36, -36), (36, 36), (-36, -36), (-36, 36))]
    posts = [make_rod((-36, y, 70), (-48, y, 150), 4.4, "wood", SIDE_MM, 3.6) for y in (-36, 36)]
    bars = [make_rod((x, -36, z), (x, 36, z), 3.4, "wood", SIDE_MM) for x, z in ((-40.5, 100), (-44, 122), (-47, 144))]
    struts = [make_rod((36, -36, 26), (36, 36, 26), 2.6, "wood", SIDE_MM), make_rod((-36, -36, 34), (-36, 36, 34), 2.6, "wood", SIDE_MM)]
    seat = make_turned([(0, 68), (52, 68, 2), (52, 75, 2), (0, 75)], "wood", SIDE_MM)
    cushion = make_turned([(0, 74), (44, 74, 4), (44, 84, 5), (0, 87)], "cushion", SIDE_MM)
    panels = [
        make_mottled_panel("wood", SIDE_MM, "#b98a55", 20, 0.16),
        make_mottled_panel("cushion", SIDE_MM, "#d9d3c4", 21, 0.06, _draw_checks),
    ]
    return Product([*legs, *posts, *bars, *struts, seat, cushion], panels)


def _draw_checks(canvas: Canvas) -> None:
    for at in np.arange(0, SIDE_MM, 7.5):
        canvas.rectangle(float(at), 0.0, 2.6, SIDE_MM, "#3f5f8f", 0.6)
        canvas.rectangle(0.0, float(at), SIDE_MM, 2.6, "#3f5f8f", 0.6)
