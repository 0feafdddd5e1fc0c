"""Pictures made of shapes: what the packages show of their contents."""

import numpy as np

from zeroshop_steps.synthetic.products.canvas import Canvas, LinearGradient, RadialGradient, rotate_points


def draw_leaf(canvas: Canvas, x: float, y: float, length: float, turn: float, light: str = "#7fb342", dark: str = "#2f6b1f") -> None:
    """A pointed leaf that starts at (x, y); turn 0 points right, positive turns clockwise."""
    t = np.linspace(0, 1, 24)
    half = 0.26 * length * np.sin(np.pi * t**0.8)
    upper, lower = np.stack([t * length, -half], 1), np.stack([t * length, half], 1)[::-1]
    canvas.polygon(rotate_points(np.concatenate([upper, lower]), turn) + (x, y), LinearGradient(light, dark))
    canvas.line(rotate_points([(0, 0), (0.92 * length, 0)], turn) + (x, y), 0.025 * length, "#cfe3a0")
    for at in (0.25, 0.42, 0.59, 0.76):
        for side in (-1, 1):
            vein = [(at * length, 0), ((at + 0.1) * length, side * 0.17 * length * np.sin(np.pi * (at + 0.1)))]
            canvas.line(rotate_points(vein, turn) + (x, y), 0.012 * length, "#cfe3a0", 0.8)


def draw_tomato(canvas: Canvas, x: float, y: float, radius: float) -> None:
    """A ripe tomato with its calyx."""
    canvas.ellipse(x, y + radius * 0.86, radius * 0.9, radius * 0.16, "#2a0b05", 0.5, radius * 0.08)
    canvas.ellipse(x, y, radius, radius * 0.88, RadialGradient("#ff6a4a", "#a80f10", (0.36, 0.3), 1.25))
    canvas.ellipse(x - radius * 0.42, y - radius * 0.4, radius * 0.22, radius * 0.11, "#ffffff", 0.65, radius * 0.03, -30)
    for i in range(5):
        draw_leaf(canvas, x + radius * 0.05, y - radius * 0.66, radius * 0.52, 10 + 72 * i, "#6fae3a", "#2c6a20")
    canvas.line([(x + radius * 0.05, y - radius * 0.66), (x + radius * 0.2, y - radius * 1.08)], radius * 0.1, "#3f7a2a")


def draw_tomato_slice(canvas: Canvas, x: float, y: float, radius: float) -> None:
    """A cut tomato with four seed chambers."""
    canvas.ellipse(x, y, radius, radius, "#b3150f")
    canvas.ellipse(x, y, radius * 0.93, radius * 0.93, RadialGradient("#ff8a66", "#e8402c", (0.5, 0.5), 1.0))
    for i in range(4):
        middle = rotate_points([(radius * 0.5, 0)], 45 + 90 * i)[0] + (x, y)
        canvas.ellipse(middle[0], middle[1], radius * 0.3, radius * 0.24, "#c9281c", turn=45 + 90 * i)
        for j in range(6):
            seed = rotate_points([(radius * 0.5 + radius * 0.17 * np.cos(j * 1.05), radius * 0.13 * np.sin(j * 1.05))], 45 + 90 * i)[0] + (
                x,
                y,
            )
            canvas.ellipse(seed[0], seed[1], radius * 0.055, radius * 0.035, "#f6d27a", turn=60 * j)


def draw_citrus_slice(canvas: Canvas, x: float, y: float, radius: float, peel: str = "#f6c400", flesh: str = "#ffe56b") -> None:
    """A cut lemon or orange."""
    canvas.ellipse(x, y, radius, radius, peel)
    canvas.ellipse(x, y, radius * 0.91, radius * 0.91, "#fffbe6")
    for i in range(9):
        width = 2 * np.pi / 9 * 0.86
        angle = 2 * np.pi * i / 9 + np.linspace(-width / 2, width / 2, 9)
        tip = radius * 0.12 * np.array([np.cos(angle[4]), np.sin(angle[4])])
        rim = 0.84 * radius * np.stack([np.cos(angle), np.sin(angle)], 1)
        canvas.polygon(np.concatenate([[tip], rim]) + (x, y), RadialGradient(flesh, peel, (0.5, 0.5), 1.8))


def draw_cracker(canvas: Canvas, x: float, y: float, size: float, turn: float, seed: int) -> None:
    """A square baked cracker with a wavy rim, holes and seeds."""
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    reach = size / 2 / (np.abs(np.cos(angle)) ** 8 + np.abs(np.sin(angle)) ** 8) ** (1 / 8) * (1 + 0.022 * np.cos(36 * angle))
    rim = np.stack([reach * np.cos(angle), reach * np.sin(angle)], 1)
    canvas.polygon(rotate_points(rim, turn) + (x + size * 0.05, y + size * 0.07), "#3a1c05", 0.5, size * 0.03)
    canvas.polygon(rotate_points(rim, turn) + (x, y), RadialGradient("#f7cf86", "#b86a1d", (0.45, 0.4), 1.35))
    canvas.polygon(rotate_points(rim * 0.9, turn) + (x, y), RadialGradient("#fbdc9c", "#e2a24c", (0.45, 0.4), 1.3))
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            hole = rotate_points([(column * size * 0.27, row * size * 0.27)], turn)[0] + (x, y)
            canvas.ellipse(hole[0], hole[1], size * 0.026, size * 0.026, "#7a4310")
    random = np.random.default_rng(seed)
    for place, tilt, kind in zip(random.uniform(-0.4, 0.4, (26, 2)) * size, random.uniform(0, 180, 26), random.random(26), strict=True):
        spot = rotate_points(place[None], turn)[0] + (x, y)
        canvas.ellipse(spot[0], spot[1], size * 0.022, size * 0.012, "#4a2a10" if kind < 0.4 else "#fff2cf", turn=tilt)


def draw_wheat(canvas: Canvas, x: float, y: float, height: float, turn: float) -> None:
    """An ear of wheat whose stalk starts at (x, y) and points up, turned clockwise by `turn`."""
    colour = "#e9b949"
    canvas.line(rotate_points([(0, 0), (0, -height * 0.96)], turn) + (x, y), height * 0.018, colour)
    for i in range(7):
        at = -height * (0.42 + 0.08 * i)
        for side in (-1, 1):
            grain = rotate_points([(side * height * 0.055, at)], turn)[0] + (x, y)
            canvas.ellipse(grain[0], grain[1], height * 0.028, height * 0.065, LinearGradient("#fff0b8", colour), turn=turn + side * 28)
            beard = [(side * height * 0.08, at - 0.04 * height), (side * height * 0.15, at - height * 0.2)]
            canvas.line(rotate_points(beard, turn) + (x, y), height * 0.007, colour)


def draw_raspberry(canvas: Canvas, x: float, y: float, radius: float) -> None:
    """A raspberry of many small drupes."""
    for row in range(7):
        level = (row - 2.6) / 3.2
        half = radius * 0.92 * np.sqrt(max(1 - (level * 0.82) ** 2, 0.05)) * (1 - 0.12 * row / 6)
        for column in range(6):
            at = x + half * (column - 2.5 + 0.25 * (-1) ** row) / 2.7
            canvas.ellipse(at, y + level * radius, radius * 0.21, radius * 0.2, RadialGradient("#ff7a9c", "#a30d3c", (0.35, 0.3), 1.2))
            canvas.ellipse(at - radius * 0.06, y + level * radius - radius * 0.07, radius * 0.04, radius * 0.03, "#ffffff", 0.8)
    for i in range(5):
        draw_leaf(canvas, x, y - radius * 0.85, radius * 0.6, 200 + 35 * i, "#8cc152", "#3b7d23")


def draw_fish(canvas: Canvas, x: float, y: float, length: float, mirrored: bool = False) -> None:
    """A tuna that swims to the left (to the right when mirrored)."""
    sign = -1.0 if mirrored else 1.0
    t = np.linspace(0, 1, 60)
    half = 0.27 * np.sin(np.pi * t**0.62) ** 0.9 * (1 - 0.55 * t) + 0.012
    back, belly = np.stack([t - 0.5, -half], 1), np.stack([t - 0.5, half * 0.86], 1)[::-1]

    def draw(points: np.ndarray | list, fill: LinearGradient | RadialGradient | str, alpha: float = 1.0) -> None:
        canvas.polygon(np.asarray(points) * (sign * length, length) + (x, y), fill, alpha)

    draw([(0.44, 0), (0.64, -0.2), (0.57, 0), (0.64, 0.2)], LinearGradient("#1d3f66", "#3c6c99"))
    draw([(-0.05, -0.19), (0.1, -0.33), (0.13, -0.15)], "#244a74")
    draw([(0.02, 0.15), (0.15, 0.3), (0.15, 0.12)], "#5d87ad")
    draw(np.concatenate([back, belly]), LinearGradient("#1b3b63", "#eef4f8"))
    for i in range(9):
        at = 0.14 + 0.036 * i
        draw([(at, -0.11 + 0.009 * i), (at + 0.02, -0.125 + 0.009 * i), (at + 0.035, -0.075 + 0.006 * i)], "#e8b923")
    draw([(-0.2, 0.03), (-0.02, 0.07), (-0.17, 0.1)], "#2f5986")
    canvas.line(np.array([(-0.3, -0.1), (-0.27, 0.0), (-0.3, 0.1)]) * (sign * length, length) + (x, y), length * 0.008, "#17304f")
    canvas.ellipse(x - sign * length * 0.4, y - length * 0.035, length * 0.024, length * 0.024, "#f6f2d8")
    canvas.ellipse(x - sign * length * 0.4, y - length * 0.035, length * 0.013, length * 0.013, "#0b1420")


def draw_waves(canvas: Canvas, y: float, height: float, colours: tuple[str, ...]) -> None:
    """Bands of sea across the sheet, from y down; a whole number of waves, so that they meet around a can."""
    x = np.linspace(0, canvas.width_mm, 400)
    for i, colour in enumerate(colours):
        top = y + height * i / len(colours) + 0.14 * height * np.sin(2 * np.pi * (6 + i) * x / canvas.width_mm + 1.7 * i)
        canvas.polygon([*zip(x, top, strict=True), (canvas.width_mm, canvas.height_mm), (0, canvas.height_mm)], colour)


def draw_jelly(canvas: Canvas, x: float, y: float, width: float, inner: str = "#ff6b8f", outer: str = "#a50b3b") -> None:
    """A turned-out fluted jelly on a plate; (x, y) is the middle of its foot."""
    canvas.ellipse(x, y + width * 0.03, width * 0.72, width * 0.13, "#54112b", 0.45, width * 0.03)
    canvas.ellipse(x, y, width * 0.7, width * 0.12, LinearGradient("#ffffff", "#c9d4de"))
    canvas.ellipse(x, y - width * 0.015, width * 0.58, width * 0.085, "#e4ebf1")
    for i in (-3, 3, -2, 2, -1, 1, 0):
        low, high = x + width * 0.15 * i, x + width * 0.1 * i
        lobe = [(low - width * 0.1, y - width * 0.03), (high - width * 0.07, y - width * 0.52), (high, y - width * 0.59)]
        lobe += [(high + width * 0.07, y - width * 0.52), (low + width * 0.1, y - width * 0.03), (low, y + width * 0.035)]
        canvas.polygon(lobe, RadialGradient(inner, outer, (0.4, 0.3), 1.25))
        canvas.line([(low - width * 0.04, y - width * 0.1), (high - width * 0.03, y - width * 0.48)], width * 0.014, "#ffd3df", 0.75)
    canvas.ellipse(x, y - width * 0.555, width * 0.33, width * 0.07, RadialGradient("#ff9db6", inner, (0.4, 0.4), 1.2))
