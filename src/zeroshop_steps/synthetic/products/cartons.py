"""Folding cartons: crackers and jelly powder."""

from collections.abc import Callable

from zeroshop_steps.synthetic.products.assemble import Product
from zeroshop_steps.synthetic.products.canvas import Canvas, LinearGradient, RadialGradient
from zeroshop_steps.synthetic.products.illustrations import draw_cracker, draw_jelly, draw_leaf, draw_raspberry, draw_wheat
from zeroshop_steps.synthetic.products.panels import Panel
from zeroshop_steps.synthetic.products.printing import draw_badge, draw_barcode, draw_nutrition_table, draw_paragraph, draw_recycling_mark
from zeroshop_steps.synthetic.products.solids import make_rounded_box

Draw = Callable[[Canvas], None]


def cracker_carton() -> Product:
    """A 160 x 62 x 214 mm carton of crackers."""
    prints: dict[str, Draw] = {
        "front": _cracker_front,
        "back": _cracker_back,
        "right": _cracker_nutrition,
        "left": _cracker_story,
        "top": _cracker_top,
        "bottom": _cracker_bottom,
    }
    return _make_carton((62.0, 160.0, 214.0), 1.4, prints, bulge_mm=1.2)


def gelatin_carton() -> Product:
    """An 89 x 30 x 74 mm carton of jelly powder."""
    prints: dict[str, Draw] = {
        "front": _jelly_front,
        "back": _jelly_back,
        "right": _jelly_side,
        "left": _jelly_method,
        "top": _jelly_top,
        "bottom": _jelly_bottom,
    }
    return _make_carton((30.0, 89.0, 74.0), 0.9, prints, bulge_mm=0.5)


def _make_carton(size_mm: tuple[float, float, float], radius: float, prints: dict[str, Draw], bulge_mm: float) -> Product:
    x, y, z = size_mm
    sizes = {"front": (y, z), "back": (y, z), "right": (x, z), "left": (x, z), "top": (y, x), "bottom": (y, x)}
    panels = [Panel(name, *sizes[name], draw) for name, draw in prints.items()]
    return Product([make_rounded_box(size_mm, radius, step_mm=max(size_mm) / 60, bulge_mm=bulge_mm)], panels)


CRACKER_ROWS = (
    ("Energy", "1850 kJ"),
    (" ", "440 kcal"),
    ("Fat", "14.2 g"),
    (" of which saturates", "1.9 g"),
    ("Carbohydrate", "63.5 g"),
    (" of which sugars", "4.8 g"),
    ("Fibre", "6.1 g"),
    ("Protein", "11.4 g"),
    ("Salt", "1.7 g"),
)


def _cracker_logo(canvas: Canvas, x: float, y: float, width: float) -> None:
    canvas.ellipse(x + 0.01 * width, y + 0.012 * width, width / 2, width * 0.2, "#3d0508", 0.45, width * 0.012)
    canvas.ellipse(x, y, width / 2, width * 0.2, "#ffd23f")
    canvas.ellipse(x, y, width * 0.485, width * 0.187, LinearGradient("#1f4fa3", "#0b2358"))
    canvas.text(
        x,
        y + width * 0.055,
        "Krumbelle",
        width * 0.125,
        "#ffffff",
        "script",
        max_width=width * 0.86,
        arch_mm=width * 0.02,
        edge="#081a40",
        edge_mm=width * 0.006,
    )
    canvas.text(x, y + width * 0.125, "BAKERS SINCE 1931", width * 0.03, "#ffd23f", "bold", max_width=width * 0.5)
    canvas.text(x, y - width * 0.1, "* * *", width * 0.05, "#ffd23f", "bold")


def _cracker_front(canvas: Canvas) -> None:
    canvas.fill(LinearGradient("#d81f26", "#8a0d12"))
    canvas.ellipse(80, 150, 120, 75, RadialGradient("#ffdf8a", "#d81f26", (0.5, 0.5), 1.0))
    _cracker_logo(canvas, 80, 38, 136)
    canvas.text(80, 88, "SEEDED", 14.5, "#ffffff", "bold", max_width=128, edge="#5e0609", edge_mm=0.9)
    canvas.text(80, 104, "WHEAT CRACKERS", 9.0, "#ffe9a8", "bold", max_width=128, edge="#5e0609", edge_mm=0.6)
    for turn, x in ((-28, 24), (-14, 16), (26, 138), (13, 146)):
        draw_wheat(canvas, x, 178, 62, turn)
    for x, y, size, turn, seed in ((52, 168, 46, -18, 1), (112, 170, 44, 24, 2), (80, 140, 48, 8, 3), (84, 179, 50, -8, 4)):
        draw_cracker(canvas, x, y, size, turn, seed)
    draw_badge(canvas, 136, 122, 15, ("40%", "MORE", "SEEDS"), "#2f7d32", teeth=24)
    draw_badge(canvas, 22, 122, 12, ("OVEN", "BAKED"), RadialGradient("#ff9d2e", "#c45a00"))
    canvas.rectangle(0, 201, 160, 13, "#0b2358")
    canvas.text(6, 210.5, "NET WT 350 g  (12.3 oz)", 4.2, "#ffffff", "bold", "left", max_width=90)
    canvas.text(154, 210.5, "3 x 18 crackers", 3.6, "#ffd23f", "sans", "right", max_width=55)


def _cracker_back(canvas: Canvas) -> None:
    canvas.fill(LinearGradient("#fff6df", "#f3d79c"))
    canvas.rectangle(0, 0, 160, 30, LinearGradient("#d81f26", "#a31116"))
    canvas.text(80, 21, "Snack time, all the time!", 9.5, "#ffffff", "script", max_width=146)
    for i, (name, top, colour) in enumerate(
        (("Garden cheese", "#f5f1dc", "#4f9a3b"), ("Smoked salmon", "#ee8a64", "#c4502b"), ("Plum chutney", "#6d2b52", "#4a1838"))
    ):
        y = 58 + 37 * i
        canvas.rectangle(8, y - 16, 144, 33, "#ffffff", 0.75, radius=4)
        draw_cracker(canvas, 28, y, 26, 6 - 9 * i, 10 + i)
        canvas.ellipse(28, y - 1, 9, 7, RadialGradient(top, colour, (0.4, 0.35), 1.6), turn=20 * i)
        draw_leaf(canvas, 27, y - 2, 9, -35 + 20 * i)
        canvas.text(48, y - 6, name, 4.6, colour, "bold", "left", max_width=98)
        advice = (
            "Spread soft cheese thickly, add cucumber, chives and a little black pepper.",
            "Top with crème fraîche, a slice of salmon and dill. Serve at once with lemon.",
            "A spoon of chutney, a shaving of hard cheese and one walnut half on each.",
        )[i]
        draw_paragraph(canvas, 48, y - 2, 98, advice, 2.7, "#3a2a18")
    canvas.line([(8, 154), (152, 154)], 0.6, "#a31116")
    words = (
        "INGREDIENTS: Wheat flour, wholemeal wheat flour (18%), sunflower oil, sesame seeds (6%), linseed (4%), poppy seeds "
        "(3%), barley malt extract, sugar, salt, raising agents (ammonium and sodium bicarbonates), yeast, rosemary extract. "
        "ALLERGENS: contains WHEAT, BARLEY and SESAME. May contain traces of MILK and SOYA. Store in a cool and dry place. "
        "Once opened, close the inner bag tightly and eat within seven days. Best before: see top of pack."
    )
    draw_paragraph(canvas, 8, 158, 92, words, 1.9, "#2a1a0c")
    draw_barcode(canvas, 108, 158, 44, 28, "204110350217")
    canvas.text(130, 193, "Questions? Write to us:", 2.1, "#3a2a18", "sans", max_width=44)
    canvas.text(130, 198, "Krumbelle Bakery, Old Mill 7", 2.1, "#3a2a18", "bold", max_width=44)
    draw_recycling_mark(canvas, 112, 206, 7, "21", "#2f7d32")
    canvas.text(120, 208, "PAP  please recycle", 2.4, "#2f7d32", "bold", "left", max_width=34)


def _cracker_nutrition(canvas: Canvas) -> None:
    canvas.fill(LinearGradient("#b5151b", "#7a0b10"))
    canvas.text(31, 20, "Krumbelle", 8.0, "#ffffff", "script", max_width=54)
    canvas.text(31, 28, "Seeded Wheat Crackers", 2.9, "#ffd23f", "bold", max_width=54)
    height = draw_nutrition_table(canvas, 5, 36, 52, CRACKER_ROWS, cap=2.5)
    draw_paragraph(canvas, 5, 40 + height, 52, "One serving is 6 crackers (30 g). This pack holds about 12 servings.", 2.2, "#ffffff")
    for i, (name, amount, colour) in enumerate((("FAT", "6%", "#f0b429"), ("SUGARS", "2%", "#4f9a3b"), ("SALT", "9%", "#f0b429"))):
        canvas.rectangle(5 + 17.6 * i, 118, 16.4, 22, colour, radius=3)
        canvas.text(13.2 + 17.6 * i, 125, name, 2.3, "#1a1a1a", "bold", max_width=14)
        canvas.text(13.2 + 17.6 * i, 135, amount, 5.0, "#1a1a1a", "bold", max_width=14)
    draw_wheat(canvas, 20, 206, 58, -10)
    draw_wheat(canvas, 31, 206, 62, 2)
    draw_wheat(canvas, 43, 206, 56, 13)


def _cracker_story(canvas: Canvas) -> None:
    canvas.fill(LinearGradient("#0b2358", "#1f4fa3"))
    canvas.text(26, 128, "Krumbelle", 17, "#ffffff", "script", turn=90, max_width=150, edge="#050f2a", edge_mm=0.8)
    canvas.text(44, 128, "Seeded Wheat Crackers", 6.5, "#ffd23f", "bold", turn=90, max_width=140)
    canvas.rectangle(4, 4, 54, 40, "#fff6df", radius=3)
    canvas.text(31, 13, "Our oven, our seeds", 3.6, "#a31116", "bold", max_width=48)
    story = (
        "Every cracker rests for nine hours before it meets the fire. That is why it snaps the way it does. "
        "Sesame, linseed and poppy from fields nearby."
    )
    draw_paragraph(canvas, 8, 17, 46, story, 2.2, "#3a2a18")


def _cracker_top(canvas: Canvas) -> None:
    canvas.fill("#a31116")
    canvas.text(80, 29, "Krumbelle", 10, "#ffffff", "script", max_width=90)
    canvas.text(80, 40, "SEEDED WHEAT CRACKERS", 3.4, "#ffd23f", "bold", max_width=90)
    canvas.line([(0, 47), (160, 47)], 0.5, "#5e0609")
    canvas.text(80, 54, "TO OPEN: lift the flap and slide a finger along", 2.4, "#ffe9a8", "sans", max_width=120)
    canvas.rectangle(118, 6, 36, 14, "#ffffff", radius=1)
    canvas.text(136, 12, "BEST BEFORE", 2.2, "#1a1a1a", "bold", max_width=32)
    canvas.text(136, 17.5, "14 MAR  L7203", 2.6, "#1a1a1a", "mono", max_width=32)
    draw_cracker(canvas, 20, 23, 26, 12, 21)


def _cracker_bottom(canvas: Canvas) -> None:
    canvas.fill("#d9c7a4")
    canvas.line([(0, 31), (160, 31)], 0.5, "#9c8a66")
    draw_recycling_mark(canvas, 24, 18, 14, "21", "#5c4a2c")
    canvas.text(80, 20, "CARTON 04-118  KB/350", 3.2, "#5c4a2c", "mono", max_width=80)
    for i, colour in enumerate(("#d81f26", "#0b2358", "#ffd23f", "#2f7d32", "#111111")):
        canvas.ellipse(112 + 9 * i, 46, 3.4, 3.4, colour)


JELLY_ROWS = (
    ("Energy", "268 kJ"),
    (" ", "63 kcal"),
    ("Fat", "0 g"),
    ("Carbohydrate", "14.1 g"),
    (" of which sugars", "13.8 g"),
    ("Protein", "1.6 g"),
    ("Salt", "0.2 g"),
)


def _jelly_front(canvas: Canvas) -> None:
    canvas.fill(LinearGradient("#ffffff", "#ffd9e4"))
    canvas.polygon([(0, 0), (89, 0), (89, 17), (45, 24), (0, 17)], LinearGradient("#c2185b", "#8c0f45"))
    canvas.text(44.5, 15.5, "WOBBLO", 10, "#ffffff", "bold", max_width=74, arch_mm=2.0, edge="#5c0830", edge_mm=0.7)
    canvas.text(30, 33, "raspberry", 5.6, "#a50b3b", "script", max_width=46)
    canvas.text(30, 39, "JELLY POWDER", 2.7, "#5c0830", "bold", max_width=40)
    draw_jelly(canvas, 58, 64, 36)
    for x, y, radius in ((12, 47, 5.6), (24, 51, 6.6), (12, 60, 5.4)):
        draw_raspberry(canvas, x, y, radius)
    draw_badge(canvas, 79, 33, 7.5, ("NO", "SUGAR", "ADDED"), "#3b7d23", teeth=18)
    canvas.text(4, 72, "NET 85 g", 2.2, "#5c0830", "bold", "left")
    canvas.text(85, 72, "makes 0.5 l", 2.2, "#5c0830", "sans", "right")


def _jelly_back(canvas: Canvas) -> None:
    canvas.fill("#fff3f6")
    canvas.rectangle(0, 0, 89, 11, "#c2185b")
    canvas.text(5, 8, "Wobblo it is!", 4.0, "#ffffff", "script", "left", max_width=50)
    for i, step in enumerate(
        (
            "Stir the powder into 250 ml boiling water.",
            "Add 250 ml cold water, stir again, pour into a mould.",
            "Chill for four hours and turn out.",
        )
    ):
        canvas.ellipse(8, 18 + 10 * i, 3.4, 3.4, "#c2185b")
        canvas.text(8, 19.6 + 10 * i, str(i + 1), 3.2, "#ffffff")
        draw_paragraph(canvas, 14, 15 + 10 * i, 30, step, 1.5, "#4a1830")
    draw_nutrition_table(canvas, 48, 14, 37, JELLY_ROWS, cap=1.6)
    words = (
        "INGREDIENTS: beef gelatine, acids (citric acid, fumaric acid), acidity regulator sodium citrate, raspberry juice "
        "powder 2.4%, flavouring, sweeteners (aspartame, acesulfame K), colour beetroot red. Contains a source of phenylalanine."
    )
    draw_paragraph(canvas, 4, 47, 42, words, 1.25, "#4a1830")
    draw_barcode(canvas, 52, 47, 32, 22, "207310085144")


def _jelly_side(canvas: Canvas) -> None:
    canvas.fill(LinearGradient("#8c0f45", "#c2185b"))
    canvas.text(19, 37, "WOBBLO", 9, "#ffffff", "bold", turn=90, max_width=62, edge="#5c0830", edge_mm=0.6)
    canvas.text(26.5, 37, "raspberry jelly powder", 2.6, "#ffd9e4", "sans", turn=90, max_width=60)


def _jelly_method(canvas: Canvas) -> None:
    canvas.fill("#ffd9e4")
    for i, colour in enumerate(("#c2185b", "#f57c00", "#fbc02d", "#7cb342")):
        draw_jelly(canvas, 15, 18 + 15 * i, 11, "#ffb0c4", colour)
    canvas.text(15, 7, "Try all four!", 2.6, "#8c0f45", "bold", max_width=26)
    canvas.text(15, 71, "raspberry orange lemon lime", 1.5, "#8c0f45", "sans", max_width=26)


def _jelly_top(canvas: Canvas) -> None:
    canvas.fill("#c2185b")
    canvas.text(44.5, 19, "WOBBLO", 8, "#ffffff", "bold", max_width=60)
    canvas.text(44.5, 25.5, "push here and tear", 2.2, "#ffd9e4", "sans", max_width=50)
    draw_raspberry(canvas, 9, 16, 5)


def _jelly_bottom(canvas: Canvas) -> None:
    canvas.fill("#f4e6ea")
    canvas.line([(0, 15), (89, 15)], 0.4, "#b58a98")
    canvas.text(44, 10, "BEST BEFORE 08 / 29   W1142", 2.4, "#1a1a1a", "mono", max_width=60)
    draw_recycling_mark(canvas, 78, 22, 7, "21", "#8c0f45")
