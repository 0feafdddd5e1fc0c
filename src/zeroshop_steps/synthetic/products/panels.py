"""Panels (printed surfaces) and their place in one square texture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.images import spread_colors
from zeroshop_steps.synthetic.products.canvas import Canvas

GUTTER_PX = 8
SUPERSAMPLING = 2


@dataclass(frozen=True)
class Panel:
    """A rectangle of surface with its print.

    Attributes:
        name: what the patches of a solid call it.
        width_mm, height_mm: its size; patches address it in mm from its lower left corner, y up.
        draw: prints it.
        density: pixels per mm relative to the texture's other panels; low for surfaces of one colour.
    """

    name: str
    width_mm: float
    height_mm: float
    draw: Callable[[Canvas], None]
    density: float = 1.0


def make_plain_panel(name: str, width_mm: float, height_mm: float, colour: str) -> Panel:
    """A panel of one colour."""
    return Panel(name, width_mm, height_mm, lambda canvas: canvas.fill(colour), density=0.12)


@dataclass(frozen=True)
class PanelPlace:
    """Where a panel lies in the texture: pixel rectangle, origin at the upper left."""

    left: int
    top: int
    width: int
    height: int


def pack_panels(panels: Sequence[Panel], size_px: int) -> tuple[dict[str, PanelPlace], float]:
    """Place the panels on shelves at the largest common density that fits.

    Returns the places by panel name and the density in px per mm (of panels with density 1).
    """
    low, high = 0.5, 60.0
    for _ in range(24):
        middle = (low + high) / 2
        low, high = (middle, high) if _pack_shelves(panels, size_px, middle) is not None else (low, middle)
    places = _pack_shelves(panels, size_px, low)
    if places is None:
        raise ValueError(f"the panels {[panel.name for panel in panels]} do not fit into {size_px} px")
    return places, low


def print_texture(panels: Sequence[Panel], places: dict[str, PanelPlace], px_per_mm: float, size_px: int) -> np.ndarray:
    """Draw every panel, supersampled, into one (size_px, size_px, 3) uint8 RGB texture.

    Texels between the panels take the colour of the nearest one, so that filtering never mixes in a foreign colour.
    """
    texture = np.zeros((size_px, size_px, 3), np.uint8)
    printed = np.zeros((size_px, size_px), bool)
    for panel in panels:
        place = places[panel.name]
        size = (place.width * SUPERSAMPLING, place.height * SUPERSAMPLING)
        canvas = Canvas(panel.width_mm, panel.height_mm, px_per_mm * panel.density * SUPERSAMPLING, size)
        panel.draw(canvas)
        image = cv2.resize(canvas.pixels, (place.width, place.height), interpolation=cv2.INTER_AREA)
        rows, columns = slice(place.top, place.top + place.height), slice(place.left, place.left + place.width)
        texture[rows, columns], printed[rows, columns] = image, True
    return spread_colors(texture, printed)


def map_to_texture(uv_mm: np.ndarray, panel: Panel, place: PanelPlace, size_px: int) -> np.ndarray:
    """Texture coordinates (V, 2), origin at the texture's lower left, of points (V, 2) in mm on a panel."""
    fraction = np.clip(uv_mm / (panel.width_mm, panel.height_mm), 0.0, 1.0)
    u = place.left + fraction[:, 0] * place.width
    v = size_px - (place.top + place.height) + fraction[:, 1] * place.height
    return np.stack([u, v], 1) / size_px


def _pack_shelves(panels: Sequence[Panel], size_px: int, px_per_mm: float) -> dict[str, PanelPlace] | None:
    sizes = {
        panel.name: tuple(max(int(round(side * px_per_mm * panel.density)), 8) for side in (panel.width_mm, panel.height_mm))
        for panel in panels
    }
    places: dict[str, PanelPlace] = {}
    shelves: list[list[int]] = []  # top, height, next free x
    for name, (width, height) in sorted(sizes.items(), key=lambda item: (-item[1][1], -item[1][0], item[0])):
        outer_width, outer_height = width + GUTTER_PX, height + GUTTER_PX
        shelf = next((shelf for shelf in shelves if shelf[2] + outer_width <= size_px and outer_height <= shelf[1]), None)
        if shelf is None:
            top = shelves[-1][0] + shelves[-1][1] if shelves else 0
            if top + outer_height > size_px or outer_width > size_px:
                return None
            shelf = [top, outer_height, 0]
            shelves.append(shelf)
        places[name] = PanelPlace(shelf[2] + GUTTER_PX // 2, shelf[0] + GUTTER_PX // 2, width, height)
        shelf[2] += outer_width
    return places
