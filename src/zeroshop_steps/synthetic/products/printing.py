"""What is printed on every package: bar codes, nutrition tables, small type, badges."""

from collections.abc import Sequence

import numpy as np

from zeroshop_steps.synthetic.products.canvas import Canvas, Fill

_LEFT_ODD = ("0001101", "0011001", "0010011", "0111101", "0100011", "0110001", "0101111", "0111011", "0110111", "0001011")
_PARITY = ("LLLLLL", "LLGLGG", "LLGGLG", "LLGGGL", "LGLLGG", "LGGLLG", "LGGGLL", "LGLGLG", "LGLGGL", "LGGLGL")


def encode_ean13(digits: str) -> str:
    """The 95 modules ("1" is black) of an EAN-13 code; `digits` are its first twelve, the check digit is appended."""
    digits += str(-sum(int(digit) * (3 if i % 2 else 1) for i, digit in enumerate(digits)) % 10)
    left = ""
    for digit, parity in zip(digits[1:7], _PARITY[int(digits[0])], strict=True):
        odd = _LEFT_ODD[int(digit)]
        left += odd if parity == "L" else _invert(odd)[::-1]
    return "101" + left + "01010" + "".join(_invert(_LEFT_ODD[int(digit)]) for digit in digits[7:]) + "101"


def draw_barcode(canvas: Canvas, x: float, y: float, width: float, height: float, digits: str) -> None:
    """An EAN-13 code on white with its digits below; twelve digits are given (20-29 in front: for use within a shop)."""
    canvas.rectangle(x, y, width, height, "#ffffff", radius=0.6)
    module = width / 113
    bars = encode_ean13(digits)
    for i, bar in enumerate(bars):
        if bar == "1":
            guard = i < 3 or i > 91 or 45 <= i < 50
            canvas.rectangle(x + (9 + i) * module, y + height * 0.06, module * 1.02, height * (0.86 if guard else 0.78), "#111111")
    check = str(-sum(int(digit) * (3 if i % 2 else 1) for i, digit in enumerate(digits)) % 10)
    cap = min(height * 0.1, width * 0.06)
    canvas.text(x + 5 * module, y + height * 0.96, digits[0], cap, "#111111", "sans")
    canvas.text(x + 34 * module, y + height * 0.96, digits[1:7], cap, "#111111", "sans", max_width=40 * module)
    canvas.text(x + 80 * module, y + height * 0.96, digits[7:] + check, cap, "#111111", "sans", max_width=40 * module)


def draw_nutrition_table(
    canvas: Canvas,
    x: float,
    y: float,
    width: float,
    rows: Sequence[tuple[str, str]],
    cap: float = 1.5,
) -> float:
    """A ruled table "typical values per 100 g"; returns its height in mm."""
    ink, pitch = "#1a1a1a", cap * 1.9
    height = pitch * (len(rows) + 2) + cap
    canvas.rectangle(x, y, width, height, "#ffffff")
    frame = [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]
    canvas.line(frame, cap * 0.2, ink)
    canvas.text(x + width / 2, y + cap * 1.7, "NUTRITION", cap * 1.15, ink, "bold", max_width=width * 0.9)
    canvas.text(x + width - cap * 0.7, y + pitch * 2 - cap * 0.1, "per 100 g", cap * 0.8, ink, "sans", "right")
    canvas.line([(x, y + pitch * 2 + cap * 0.3), (x + width, y + pitch * 2 + cap * 0.3)], cap * 0.3, ink)
    for i, (name, amount) in enumerate(rows):
        base = y + pitch * (i + 3) - cap * 0.05
        indented = name.startswith(" ")
        left = x + cap * (1.7 if indented else 0.7)
        canvas.text(left, base, name.strip(), cap, ink, "sans" if indented else "bold", "left", max_width=width * 0.62)
        canvas.text(x + width - cap * 0.7, base, amount, cap, ink, "sans", "right", max_width=width * 0.32)
        if i + 1 < len(rows):
            canvas.line([(x, base + cap * 0.4), (x + width, base + cap * 0.4)], cap * 0.08, ink)
    return height


def draw_paragraph(
    canvas: Canvas,
    x: float,
    y: float,
    width: float,
    words: str,
    cap: float,
    ink: Fill,
) -> float:
    """Text broken into lines of `width` mm; y is the top. Returns the y below the last line."""
    line: list[str] = []
    base = y + cap
    for word in words.split():
        if line and canvas.text_width(" ".join([*line, word]), cap, "sans") > width:
            canvas.text(x, base, " ".join(line), cap, ink, "sans", "left", max_width=width)
            line, base = [], base + 1.75 * cap
        line.append(word)
    if line:
        canvas.text(x, base, " ".join(line), cap, ink, "sans", "left", max_width=width)
    return base + 0.75 * cap


def draw_badge(canvas: Canvas, x: float, y: float, radius: float, lines: Sequence[str], fill: Fill, teeth: int = 0) -> None:
    """A round seal, with a toothed border where `teeth` are given, and centred lines of text."""
    if teeth:
        angle = np.linspace(0, 2 * np.pi, 4 * teeth, endpoint=False)
        reach = radius * (1 + 0.06 * np.sign(np.sin(teeth * angle + 0.3)))
        canvas.polygon(np.stack([x + reach * np.cos(angle), y + reach * np.sin(angle)], 1), fill)
    else:
        canvas.ellipse(x, y, radius, radius, fill)
    canvas.ring(x, y, radius * 0.86, radius * 0.04, "#ffffff")
    pitch = radius * 1.15 / max(len(lines), 1)
    cap = min(pitch * 0.62, radius * 0.5)
    for i, line in enumerate(lines):
        base = y + (i - (len(lines) - 1) / 2) * pitch + cap / 2
        room = 1.62 * radius * np.sqrt(max(1 - ((base - cap / 2 - y) / radius) ** 2, 0.2))
        canvas.text(x, base, line, cap, "#ffffff", "bold", max_width=room * 0.92)


def draw_recycling_mark(canvas: Canvas, x: float, y: float, size: float, number: str, ink: str) -> None:
    """Three arrows around a number, as on every package's bottom."""
    for third in range(3):
        start = np.deg2rad(120 * third - 90 + 12)
        corners = [np.array([np.cos(start + a), np.sin(start + a)]) * size / 2 + (x, y) for a in np.deg2rad([0, 30, 60, 84])]
        canvas.line(np.array(corners), size * 0.09, ink)
        direction = corners[-1] - corners[-2]
        direction /= np.linalg.norm(direction)
        side = np.array([-direction[1], direction[0]])
        tip = [corners[-1] + direction * size * 0.17, corners[-1] + side * size * 0.14, corners[-1] - side * size * 0.14]
        canvas.polygon(np.array(tip), ink)
    canvas.text(x, y + size * 0.13, number, size * 0.26, ink, "bold")


def _invert(bits: str) -> str:
    return bits.translate(str.maketrans("01", "10"))
