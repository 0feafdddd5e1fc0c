"""Tools and things of the living room: pliers, a hammer, a floor lamp, a vase with flowers, a toaster and a candlestick."""

import numpy as np

from casual_captures.bodies import make_ellipsoid, make_mottled_panel, make_rod, make_turned
from zeroshop_steps.synthetic.products.assemble import Product
from zeroshop_steps.synthetic.products.solids import Solid, make_rounded_box, transform_solid

SIDE_MM = 80.0  # of the panels


def pliers() -> Product:
    """Pliers of 180 mm that lie flat, 14 mm high: steel jaws and red handles."""
    joint = make_turned([(0, 0), (13, 0, 1), (13, 14, 2), (0, 14)], "steel", SIDE_MM)
    jaws = [make_rod((4, 4 * side, 7), (58, 2.5 * side, 7), 6.5, "steel", SIDE_MM, 2.5) for side in (-1, 1)]
    handles = []
    for side in (-1, 1):
        bend, end = (-46.0, 24.0 * side, 7.0), (-120.0, 27.0 * side, 7.0)
        handles += [make_rod((-4, 6 * side, 7), bend, 5.5, "grip", SIDE_MM, 6.5), make_rod(bend, end, 6.5, "grip", SIDE_MM, 5.5)]
        handles.append(make_ellipsoid(bend, (6.6, 6.6, 6.6), "grip", SIDE_MM))
    panels = [make_mottled_panel("steel", SIDE_MM, "#7c8086", 50, 0.1), make_mottled_panel("grip", SIDE_MM, "#b02a26", 51, 0.08)]
    return Product([joint, *jaws, *handles], panels)


def hammer() -> Product:
    """A hammer of 300 mm that lies on its side: a wooden handle and a dark head."""
    handle = [
        make_rod((0, 0, 15), (170, 0, 13), 9.0, "wood", SIDE_MM, 13.0),
        make_rod((165, 0, 13), (262, 0, 13), 13.0, "wood", SIDE_MM, 12.0),
    ]
    head = transform_solid(make_rounded_box((32.0, 62.0, 28.0), 2.0, 8.0), np.eye(3), (-8, 0, 15))
    face = make_rod((-8, 28, 15), (-8, 60, 15), 11.0, "iron", SIDE_MM, 14.0)
    peen = make_rod((-8, -28, 15), (-8, -66, 15), 12.0, "iron", SIDE_MM, 3.0)
    sides = ("front", "back", "left", "right", "top", "bottom")
    panels = [make_mottled_panel("wood", SIDE_MM, "#b58a52", 52, 0.18), make_mottled_panel("iron", SIDE_MM, "#3a3c40", 53, 0.12)]
    panels += [make_mottled_panel(name, 62.0, "#3a3c40", 54 + index, 0.12) for index, name in enumerate(sides)]
    return Product([*handle, head, face, peen], panels)


def floor_lamp() -> Product:
    """A lamp of 420 mm, a model for a doll's house: a round foot, a thin stand and a wide shade of pale cloth."""
    foot = make_turned([(0, 0), (62, 0, 2), (60, 10, 4), (8, 16, 4), (0, 18)], "brass", SIDE_MM)
    stand = make_rod((0, 0, 14), (0, 0, 330), 4.5, "brass", SIDE_MM)
    shade = make_turned([(0, 318), (95, 322, 2), (62, 420, 2), (0, 424)], "cloth", SIDE_MM)
    panels = [make_mottled_panel("brass", SIDE_MM, "#9a7b3c", 60, 0.08), make_mottled_panel("cloth", SIDE_MM, "#d8cbb0", 61, 0.08)]
    return Product([foot, stand, shade], panels)


def flower_vase() -> Product:
    """Tulips with long stalks and leaves in a blue vase, 330 mm."""
    vase = make_turned(
        [(0, 0), (32, 0, 3), (44, 40, 20), (30, 110, 20), (24, 130, 6), (30, 146, 2), (24, 146, 2), (0, 138)], "glaze", SIDE_MM
    )
    rng = np.random.default_rng(62)
    plants: list[Solid] = []
    for index in range(6):
        azimuth, lean, high = 2 * np.pi * (index + 0.25 * rng.normal()) / 6, rng.uniform(20, 80), rng.uniform(230, 300)
        along = np.array([np.cos(azimuth), np.sin(azimuth)])
        foot, tip = (*(12 * along), 134.0), (*(lean * along), float(high))
        plants.append(make_rod(foot, tip, 2.4, "stalk", SIDE_MM, 2.0))
        plants.append(make_ellipsoid((tip[0], tip[1], tip[2] + 12), (13, 13, 20), f"flower_{index % 2}", SIDE_MM))
        leaf = (*(0.75 * lean * along), float(0.45 * high + 70))
        plants.append(make_ellipsoid(leaf, (44, 8, 1.8), "leaf", SIDE_MM, (0.0, float(rng.uniform(-75, -35)), float(np.degrees(azimuth)))))
    colours = {"glaze": "#2f5b93", "stalk": "#6c8f45", "leaf": "#4c7f3f", "flower_0": "#d4482f", "flower_1": "#e6c23a"}
    return Product(
        [vase, *plants], [make_mottled_panel(name, SIDE_MM, colour, 63 + i, 0.14) for i, (name, colour) in enumerate(colours.items())]
    )


def toaster() -> Product:
    """A toaster of 260 x 150 x 170 mm: a pale grey box with nearly no print, two dark slots and a lever."""
    size = (150.0, 260.0, 165.0)
    box = transform_solid(make_rounded_box(size, 12.0, 10.0), np.eye(3), (0, 0, size[2] / 2 + 5))
    slots = [make_ellipsoid((x, 0, size[2] + 4), (11, 92, 3), "dark", SIDE_MM) for x in (-28, 28)]
    lever = [make_rod((0, 126, 120), (0, 150, 120), 9.0, "dark", SIDE_MM), make_ellipsoid((0, 130, 40), (14, 8, 14), "dark", SIDE_MM)]
    feet = [make_rod((x, y, 0), (x, y, 14), 10.0, "dark", SIDE_MM) for x in (-50, 50) for y in (-100, 100)]
    sides = ("front", "back", "left", "right", "top", "bottom")
    panels = [make_mottled_panel("dark", SIDE_MM, "#29292c", 70, 0.08)]
    panels += [make_mottled_panel(name, 260.0, "#b9bcbd", 71 + index, 0.04) for index, name in enumerate(sides)]
    return Product([box, *slots, *lever, *feet], panels)


def candlestick() -> Product:
    """A candlestick of 300 mm with three arms, and white candles on them."""
    foot = make_turned(
        [(0, 0), (48, 0, 2), (46, 8, 3), (12, 22, 8), (7, 60, 6), (11, 80, 6), (5, 110, 6), (5, 170, 2), (0, 172)], "silver", SIDE_MM
    )
    arms, candles = [], []
    for y in (-62.0, 0.0, 62.0):
        if y:
            arms += [
                make_rod((0, 0, 112), (0, 0.7 * y, 118), 3.4, "silver", SIDE_MM),
                make_rod((0, 0.7 * y, 118), (0, y, 172), 3.4, "silver", SIDE_MM),
            ]
        arms.append(make_turned([(0, 168), (14, 170, 1), (14, 178, 1), (0, 180)], "silver", SIDE_MM, (0, y, 0)))
        candles.append(make_turned([(0, 178), (8, 178, 1), (8, 292, 3), (0, 298)], "wax", SIDE_MM, (0, y, 0)))
    panels = [make_mottled_panel("silver", SIDE_MM, "#8f9296", 80, 0.1), make_mottled_panel("wax", SIDE_MM, "#ece7da", 81, 0.03)]
    return Product([foot, *arms, *candles], panels)
