"""Table tops of films: a printed ground, which registration likes best, and the plain ones that people have at home."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.synthetic.products.assemble import TEXTURE_PX
from zeroshop_steps.synthetic.scenes.scene_meshes import make_noise, make_rich_texture

PLANKS = 12  # across the table; a table of ten object sizes then has planks about as wide as the object


@dataclass(frozen=True)
class TableTop:
    """What the surface of a table looks like.

    Attributes:
        make_texture: makes the (texels, texels, 3) uint8 sRGB texture.
        mirror: reflectance at normal incidence of its varnish; 0 for a matt table, 0.04 for glass and lacquer (refractive index 1.5).
        things: other things on the table; a plain table is mostly cleared for the photos.
    """

    make_texture: Callable[[np.random.Generator], np.ndarray]
    mirror: float
    things: int


def make_wood_texture(rng: np.random.Generator) -> np.ndarray:
    """Brown planks with fine grain along x; low in contrast, and alike everywhere."""
    texels = TEXTURE_PX
    grain = cv2.resize(make_noise(rng, texels, 16, texels // 2, 0.9)[:, : texels // 24], (texels, texels))
    planks = np.repeat(rng.normal(0, 1, PLANKS), -(-texels // PLANKS))[:texels, None]
    light = 1.0 + 0.9 * (grain - 0.5) + 0.04 * planks
    edge = np.arange(texels) % (texels / PLANKS) < texels / 700
    light[edge] *= 0.7
    return np.rint(np.clip(np.array([150, 108, 70]) * light[..., None], 0, 250)).astype(np.uint8)


def _make_uniform_texture(rng: np.random.Generator, color: tuple[int, int, int]) -> np.ndarray:
    """One colour, its brightness off by about one per cent."""
    light = 1.0 + 0.04 * (make_noise(rng, TEXTURE_PX, 8, TEXTURE_PX // 2) - 0.5)
    return np.rint(np.clip(np.array(color) * light[..., None], 0, 250)).astype(np.uint8)


TABLE_TOPS = {
    "print": TableTop(make_rich_texture, 0.0, 6),
    "wood": TableTop(make_wood_texture, 0.0, 2),
    "white": TableTop(lambda rng: _make_uniform_texture(rng, (226, 224, 220)), 0.0, 2),
    "dark": TableTop(lambda rng: _make_uniform_texture(rng, (52, 50, 50)), 0.0, 2),
    "glossy": TableTop(lambda rng: _make_uniform_texture(rng, (120, 92, 70)), 0.06, 2),
}
