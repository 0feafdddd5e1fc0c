"""Tins with rolled rims, grooved lids and paper or printed labels: tomatoes and tuna."""

from collections.abc import Callable

import numpy as np

from zeroshop_steps.synthetic.products.assemble import Product
from zeroshop_steps.synthetic.products.canvas import Canvas, LinearGradient, RadialGradient
from zeroshop_steps.synthetic.products.illustrations import (
    draw_citrus_slice,
    draw_fish,
    draw_leaf,
    draw_tomato,
    draw_tomato_slice,
    draw_waves,
)
from zeroshop_steps.synthetic.products.panels import Panel, make_plain_panel
from zeroshop_steps.synthetic.products.printing import draw_badge, draw_barcode, draw_nutrition_table, draw_paragraph, draw_recycling_mark
from zeroshop_steps.synthetic.products.profiles import arc_length, round_polyline
from zeroshop_steps.synthetic.products.solids import ProfileBand, Solid, extrude, revolve, transform_solid

Draw = Callable[[Canvas], None]

STEEL, STEEL_DARK = "#c3c7cb", "#8d9298"
BRASS, BRASS_DARK = "#d9c48a", "#a88f4e"


def tomato_can() -> Product:
    """A tin of 68 mm diameter and 102 mm height with a paper label."""
    solid, panels = _make_can(33.0, 102.0, _print_tomatoes, _print_tomato_lid, _print_steel_foot, (STEEL, STEEL_DARK), grooves=3)
    return Product([solid], panels)


def tuna_can() -> Product:
    """A flat tin of 87 mm diameter and 34 mm height with a ring-pull lid."""
    solid, panels = _make_can(42.5, 33.0, _print_tuna, _print_tuna_lid, _print_brass_foot, (BRASS, BRASS_DARK), grooves=1)
    outline = round_polyline([(-7.0, -6.0, 5.5), (13.0, -8.5, 8.0), (13.0, 8.5, 8.0), (-7.0, 6.0, 5.5)], step_mm=1.5, closed=True)
    around = float(arc_length(np.concatenate([outline, outline[:1]]))[-1])
    low, high = outline.min(0), outline.max(0)
    tab = extrude(outline, 0.0, 2.2, "tab_up", "tab_down", "tab_side", edge_mm=0.8)
    panels += [
        Panel("tab_up", high[1] - low[1], high[0] - low[0], _print_tab),
        make_plain_panel("tab_down", high[1] - low[1], high[0] - low[0], STEEL),
        make_plain_panel("tab_side", around, 3.0, STEEL),
    ]
    return Product([solid, transform_solid(tab, np.eye(3), (14.0, 0.0, 33.0 - 3.0 - 0.4))], panels)


def _make_can(
    radius: float, height: float, label: Draw, lid: Draw, foot: Draw, metal: tuple[str, str], grooves: int
) -> tuple[Solid, list[Panel]]:
    """A tin whose rims stand out by 1.2 mm; `label`, `lid` and `foot` print their panels."""
    rim = radius + 1.2
    inner = radius - 1.6
    recess = 3.0
    ripples = []
    for i in range(grooves):
        at = inner - 4.0 - 4.5 * i
        ripples += [(at, 0.0, 0.6), (at - 1.0, 0.8, 0.6), (at - 2.2, 0.8, 0.6), (at - 3.2, 0.0, 0.6)]
    lid_profile = [(radius - 0.4, height), (inner + 0.5, height - 0.3, 0.4), (inner, height - recess, 0.8)]
    lid_profile += [(r, height - recess - depth, f) for r, depth, f in ripples] + [(0.0, height - recess)]
    foot_profile = [(r, height - z, *f) for r, z, *f in lid_profile][::-1]
    rim_profile = [(radius - 0.4, 0.0), (rim, 0.0, 0.9), (rim, 3.2, 0.9), (radius, 4.2)]
    low = round_polyline(rim_profile, step_mm=1.0)
    high = round_polyline([(r, height - z, *f) for r, z, *f in rim_profile][::-1], step_mm=1.0)
    wall = round_polyline([(radius, 4.2), (radius, height - 4.2)], step_mm=4.0)
    girth = 2 * np.pi * radius

    def print_rim(canvas: Canvas) -> None:
        canvas.fill(LinearGradient(metal[0], metal[1]))
        canvas.rectangle(0, 0.35 * canvas.height_mm, canvas.width_mm, 0.25 * canvas.height_mm, "#f2f4f6", 0.7)

    bands = [
        ProfileBand(round_polyline(foot_profile, step_mm=4.0), "foot", 2 * radius, foot, "down", density=0.6),
        ProfileBand(low, "rim_low", girth, print_rim, density=0.3),
        ProfileBand(wall, "label", girth, label),
        ProfileBand(high, "rim_high", girth, print_rim, density=0.3),
        ProfileBand(round_polyline(lid_profile, step_mm=4.0), "lid", 2 * radius, lid, "up", density=0.8),
    ]
    return revolve(bands, segments=128), [band.make_panel() for band in bands]


def _metal_disc(canvas: Canvas, light: str, dark: str, grooves: int) -> tuple[float, float]:
    """Brushed metal with darker grooves; returns the middle."""
    middle = canvas.width_mm / 2
    canvas.fill(light)
    canvas.ellipse(middle, middle, middle, middle, RadialGradient("#eef0f2", dark, (0.42, 0.38), 1.7), 0.55)
    for i in range(grooves):
        radius = middle - 1.6 - 5.6 - 4.5 * i
        canvas.ring(middle, middle, radius + 0.9, 0.35, dark, 0.9)
        canvas.ring(middle, middle, radius - 0.9, 0.35, "#f6f7f8", 0.9)
    return middle, middle


def _print_tomato_lid(canvas: Canvas) -> None:
    x, y = _metal_disc(canvas, STEEL, STEEL_DARK, 3)
    canvas.text(x, y - 2, "BB 11.2031", 2.6, "#3b3f44", "mono")
    canvas.text(x, y + 3, "P1 L 3207 16:42", 2.2, "#3b3f44", "mono")


def _print_steel_foot(canvas: Canvas) -> None:
    x, y = _metal_disc(canvas, STEEL, STEEL_DARK, 3)
    draw_recycling_mark(canvas, x, y, 9, "40", "#6f757b")


def _print_brass_foot(canvas: Canvas) -> None:
    x, y = _metal_disc(canvas, BRASS, BRASS_DARK, 1)
    canvas.text(x, y, "BEST BEFORE", 2.8, "#5c4a1c", "bold")
    canvas.text(x, y + 6, "30 JUN 2032  T88", 2.8, "#5c4a1c", "mono")
    draw_recycling_mark(canvas, x, y + 18, 9, "40", "#8a7434")


def _print_tab(canvas: Canvas) -> None:
    canvas.fill(LinearGradient("#dfe3e6", "#9da3a9"))
    canvas.ellipse(canvas.width_mm / 2, canvas.height_mm - 7.0, 4.6, 4.2, "#6f757b")
    canvas.ellipse(canvas.width_mm / 2, canvas.height_mm - 6.6, 3.8, 3.4, "#a88f4e")
    canvas.ellipse(canvas.width_mm / 2, 4.6, 1.9, 1.9, RadialGradient("#ffffff", "#7b8187"))


TOMATO_ROWS = (
    ("Energy", "96 kJ"),
    (" ", "23 kcal"),
    ("Fat", "0.2 g"),
    ("Carbohydrate", "3.8 g"),
    (" of which sugars", "3.4 g"),
    ("Fibre", "1.1 g"),
    ("Protein", "1.1 g"),
    ("Salt", "0.1 g"),
)


def _print_tomatoes(canvas: Canvas) -> None:
    width, height = canvas.width_mm, canvas.height_mm
    canvas.fill(LinearGradient("#fff7dc", "#f9dc9a"))
    canvas.rectangle(0, 0, width, 9, LinearGradient("#1f6b2c", "#15501f"))
    canvas.rectangle(0, 9, width, 1.2, "#e8c33b")
    canvas.rectangle(0, height - 10, width, 10, LinearGradient("#c4161c", "#8c0b10"))
    canvas.rectangle(0, height - 11.2, width, 1.2, "#e8c33b")
    x = width / 2
    canvas.ellipse(x, 27, 35, 13.5, "#1f6b2c")
    canvas.ellipse(x, 27, 33.8, 12.5, LinearGradient("#c4161c", "#8c0b10"))
    canvas.text(x, 31.5, "Pomarella", 9.2, "#ffffff", "script", max_width=58, arch_mm=1.5, edge="#5a0508", edge_mm=0.5)
    canvas.text(x, 6.8, "SUN RIPENED  *  HAND PICKED", 3.0, "#ffe9a8", "bold", max_width=66)
    draw_tomato(canvas, x - 13, 62, 14)
    draw_tomato(canvas, x + 13, 65, 11.5)
    draw_tomato_slice(canvas, x + 1, 73, 9.0)
    for turn in (200, 160, 20, -20):
        draw_leaf(canvas, x + (24 if abs(turn) < 90 else -24), 74, 10, turn)
    canvas.text(x, 46, "CHOPPED TOMATOES", 4.6, "#8c0b10", "bold", max_width=68)
    canvas.text(x, height - 3.2, "400 g  e   drained 240 g", 3.4, "#ffffff", "bold", max_width=64)
    left = width * 0.165
    canvas.text(left, 16.5, "Ingredients", 3.2, "#15501f", "script", max_width=52)
    words = (
        "Tomatoes (65%), tomato juice, tomato purée, acidity regulator: citric acid, basil. Grown, peeled and packed within "
        "eight hours. Once opened, empty into a glass bowl, cover, keep cold and use within two days. Do not heat in the tin."
    )
    below = draw_paragraph(canvas, left - 28, 19, 56, words, 1.75, "#3a2a10")
    canvas.text(left, below + 5, "Quick sauce", 3.4, "#8c0b10", "script", max_width=52)
    recipe = "Fry one onion and two cloves of garlic in olive oil, add the tin, a pinch of sugar and salt; simmer for twelve minutes."
    draw_paragraph(canvas, left - 28, below + 7, 56, recipe, 2.0, "#3a2a10")
    for i in range(3):
        draw_tomato_slice(canvas, left - 16 + 16 * i, height - 19, 6.2)
    right = width * 0.835
    draw_nutrition_table(canvas, right - 29, 14, 33, TOMATO_ROWS, cap=1.75)
    draw_barcode(canvas, right - 29, 54, 36, 25, "205518820043")
    draw_badge(canvas, right + 18, 26, 9.5, ("100%", "TOMATO"), RadialGradient("#58b947", "#1f6b2c"), teeth=18)
    draw_recycling_mark(canvas, right + 18, 48, 11, "40", "#15501f")
    draw_paragraph(canvas, right + 9, 60, 20, "Pomarella Packers, Harbour Road 12", 1.7, "#3a2a10")
    canvas.rectangle(0, 0, 0.4, height, "#b89b5a", 0.8)


TUNA_ROWS = (("Energy", "790 kJ"), ("Fat", "10 g"), (" saturates", "1.6 g"), ("Protein", "25 g"), ("Salt", "0.9 g"))


def _print_tuna(canvas: Canvas) -> None:
    width, height = canvas.width_mm, canvas.height_mm
    canvas.fill(LinearGradient("#0d2c5e", "#1765a8"))
    draw_waves(canvas, height * 0.62, height * 0.38, ("#1f7fc0", "#3d9fd6", "#7cc6e8"))
    x = width / 2
    canvas.text(x - 4, 11.0, "SALTERNO", 6.4, "#ffffff", "bold", max_width=56, edge="#06183a", edge_mm=0.4)
    canvas.text(x - 4, 16.5, "tuna chunks in olive oil", 2.7, "#ffd85a", "oblique", max_width=52)
    draw_fish(canvas, x + 42, 9.5, 25)
    canvas.text(x - 4, 3.6, "LINE CAUGHT", 1.7, "#bfe3f5", "bold")
    canvas.text(x - 4, 22.3, "160 g   drained 112 g", 2.2, "#06183a", "bold")
    draw_citrus_slice(canvas, x - 40, 9.5, 6.5)
    draw_leaf(canvas, x - 37, 14, 9, 15)
    draw_nutrition_table(canvas, width * 0.06, 2.4, 30, TUNA_ROWS, cap=1.35)
    words = "INGREDIENTS: skipjack TUNA, olive oil, water, salt. Caught by pole and line. May contain bones. Keep cold after opening."
    draw_paragraph(canvas, width * 0.06 + 32, 2.6, 24, words, 1.25, "#ffffff")
    draw_barcode(canvas, width * 0.8, 2.6, 30, 18.5, "206640017385")
    draw_badge(canvas, width * 0.95, 9.5, 6.5, ("POLE", "& LINE"), RadialGradient("#2f9e58", "#0f5a2c"))


def _print_tuna_lid(canvas: Canvas) -> None:
    x, y = _metal_disc(canvas, BRASS, BRASS_DARK, 1)
    canvas.ellipse(x, y, 32, 32, RadialGradient("#1f74b8", "#0d2c5e", (0.5, 0.5), 1.0))
    canvas.ring(x, y, 31, 0.6, "#ffd85a")
    canvas.text(x, y - 4, "SALTERNO", 7.2, "#ffffff", "bold", max_width=54, edge="#06183a", edge_mm=0.4)
    canvas.text(x, y - 14, "tuna chunks in olive oil", 3.0, "#ffd85a", "oblique", max_width=44)
    draw_fish(canvas, x, y - 22, 19, mirrored=True)
    draw_citrus_slice(canvas, x - 20, y + 11, 7)
    draw_citrus_slice(canvas, x + 20, y + 11, 7)
    canvas.text(x, y + 29.5, "lift, then pull", 2.2, "#bfe3f5", "sans")
