"""What casual photos have below the object: a desk of wood with its grain, printed cloth, bare tops, and paper that lies on them."""

from collections.abc import Callable

import cv2
import numpy as np

from zeroshop_steps.synthetic.scenes.scene_meshes import make_noise, make_rich_texture

TEXELS = 4096
WOODS = ((196, 158, 112), (164, 116, 74), (112, 74, 46), (214, 184, 142))  # oak, cherry, walnut, pine
RINGS, RING_CONTRAST, RING_WARP = 34.0, 0.22, 2.2  # growth rings across the table, how dark they are, and how far they wander
PLANKS = 5
WORDS = (
    "the",
    "of",
    "morning",
    "light",
    "council",
    "paper",
    "river",
    "market",
    "after",
    "house",
    "garden",
    "seven",
    "report",
    "music",
    "winter",
    "train",
    "city",
    "people",
)
PAPER_PX_PER_MM = 4.0


def make_desk(rng: np.random.Generator) -> np.ndarray:
    """(TEXELS, TEXELS, 3) uint8 wood: glued planks, each with growth rings and pores along x."""
    side = TEXELS
    image = np.empty((side, side, 3), np.float32)
    wood = np.array(WOODS[rng.integers(len(WOODS))], np.float32)
    edges = np.linspace(0, side, PLANKS + 1).astype(int)
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        warp = cv2.resize(make_noise(rng, 256, 4, 64)[:, :32], (side, high - low), interpolation=cv2.INTER_CUBIC)
        pores = cv2.resize(make_noise(rng, 2048, 64, 2048, 0.95)[: high - low, : 2048 // 40], (side, high - low))
        across = np.linspace(0, 1, high - low, dtype=np.float32)[:, None] + rng.uniform()
        phase = (across / PLANKS * RINGS + RING_WARP * warp) % 1.0
        light = 1.0 + RING_CONTRAST * (0.5 - phase**3) + 0.5 * (pores - 0.5) + rng.normal(0, 0.05)
        light[:2] *= 0.7
        image[low:high] = wood * light[..., None]
    return np.rint(np.clip(image, 0, 250)).astype(np.uint8)


def make_bare(rng: np.random.Generator, color: np.ndarray) -> np.ndarray:
    """One colour (3,), sRGB, its brightness off by one per cent, with a few crumbs and scratches."""
    light = 1.0 + 0.04 * (make_noise(rng, TEXELS // 2, 8, TEXELS // 2) - 0.5)
    image = np.rint(np.clip(color * light[..., None], 0, 250)).astype(np.uint8)
    for _ in range(60):
        place, end = rng.integers(0, TEXELS // 2, 2), rng.integers(-40, 40, 2)
        shade = np.clip(color * rng.uniform(0.8, 1.15), 0, 250).tolist()
        cv2.line(image, place.tolist(), (place + end).tolist(), shade, 1, cv2.LINE_AA)
    return image


def make_cloth(rng: np.random.Generator) -> np.ndarray:
    """A checked table cloth with threads."""
    base = rng.uniform(190, 240) * rng.uniform(0.94, 1.0, 3)
    check = rng.uniform(60, 180) * rng.uniform(0.6, 1.3, 3)
    stripes = (np.arange(TEXELS) * 26 // TEXELS % 2).astype(np.float32)
    share = (stripes[:, None] + stripes[None, :]) / 2
    threads = 1.0 + 0.12 * (rng.random((TEXELS, TEXELS), np.float32) - 0.5) + 0.08 * (make_noise(rng, TEXELS, 8, 512) - 0.5)
    return np.rint(np.clip((base + share[..., None] * (check - base)) * threads[..., None], 0, 250)).astype(np.uint8)


TOPS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {"desk": make_desk, "cloth": make_cloth, "print": make_rich_texture}
"""The tops that have a look of their own; `make_bare` makes one of a given colour."""


def make_newspaper(rng: np.random.Generator, width_mm: float = 300.0, height_mm: float = 400.0) -> np.ndarray:
    """(height, width, 3) uint8, `PAPER_PX_PER_MM`: headlines, columns of text and grey photos."""
    size = (int(height_mm * PAPER_PX_PER_MM), int(width_mm * PAPER_PX_PER_MM))
    page = np.full((*size, 3), rng.uniform(205, 232), np.float32) * [1.0, 0.99, 0.95]
    page = page.astype(np.uint8)
    columns, gap = int(rng.integers(3, 6)), int(5 * PAPER_PX_PER_MM)
    wide = (size[1] - gap * (columns + 1)) // columns
    for column in range(columns):
        left, row = gap + column * (wide + gap), gap + int(rng.integers(0, 60))
        while row < size[0] - gap - 20:
            kind = rng.uniform()
            if kind < 0.12:
                tall = min(int(wide * rng.uniform(0.6, 1.2)), size[0] - gap - row)
                photo = cv2.resize(make_noise(rng, 128, 4, 64, 0.8), (wide, tall))
                page[row : row + tall, left : left + wide] = (40 + 200 * np.clip((photo - 0.3) * 2.2, 0, 1))[..., None]
                row += tall + 20
            elif kind < 0.24:
                _write(page, rng, left, row + 40, wide, 1.6, 4)
                row += 66
            else:
                for _ in range(int(rng.integers(6, 18))):
                    if row < size[0] - gap - 20:
                        _write(page, rng, left, row + 12, wide, 0.42, 1)
                    row += 17
                row += 14
    return page


def make_sheet(rng: np.random.Generator, width_mm: float = 210.0, height_mm: float = 297.0) -> np.ndarray:
    """(height, width, 3) uint8: a white sheet, blank or with a few lines of writing."""
    size = (int(height_mm * PAPER_PX_PER_MM), int(width_mm * PAPER_PX_PER_MM))
    page = np.full((*size, 3), 240, np.uint8)
    if rng.uniform() < 0.6:
        for row in range(90, size[0] - 90, 34):
            if rng.uniform() < 0.8:
                _write(page, rng, 80, row, int(rng.uniform(0.4, 0.9) * (size[1] - 160)), 0.7, 1)
    return page


def _write(page: np.ndarray, rng: np.random.Generator, left: int, row: int, wide: int, scale: float, thick: int) -> None:
    """Words from `left` on, as many as fit into `wide` pixels."""
    ink = (int(rng.integers(20, 60)),) * 3
    at = left
    while True:
        word = WORDS[rng.integers(len(WORDS))]
        long = cv2.getTextSize(word, cv2.FONT_HERSHEY_SIMPLEX, scale, thick)[0][0]
        if at + long > left + wide:
            return
        cv2.putText(page, word, (at, row), cv2.FONT_HERSHEY_SIMPLEX, scale, ink, thick, cv2.LINE_AA)
        at += long + int(14 * scale)


def lay_paper(texture: np.ndarray, paper: np.ndarray, mm_per_texel: float, place_mm: np.ndarray, turn_rad: float) -> None:
    """Paint a paper onto the ground's texture in place.

    Args:
        texture: (texels, texels, 3) uint8; its middle is the origin, x to the right and y up.
        paper: (height, width, 3) uint8, `PAPER_PX_PER_MM`.
        mm_per_texel: of the texture.
        place_mm: (2,) of the paper's middle.
        turn_rad: of the paper, from x towards y.
    """
    height, width = paper.shape[:2]
    scale = 1.0 / (PAPER_PX_PER_MM * mm_per_texel)
    cosine, sine = np.cos(turn_rad) * scale, np.sin(turn_rad) * scale
    linear = np.array([[cosine, sine], [-sine, cosine]])
    centre = texture.shape[0] / 2 + np.array([place_mm[0], -place_mm[1]]) / mm_per_texel
    matrix = np.column_stack([linear, centre - linear @ [width / 2, height / 2]])
    small = cv2.GaussianBlur(paper, (0, 0), max(0.4 / scale - 0.4, 0.1))
    size = texture.shape[1::-1]
    share = cv2.warpAffine(np.ones((height, width), np.float32), matrix, size)[..., None]
    shadow = cv2.GaussianBlur(share, (0, 0), 2.5 / mm_per_texel)[..., None]
    laid = cv2.warpAffine(small, matrix, size, flags=cv2.INTER_LINEAR)
    texture[:] = np.rint(texture * (1 - 0.25 * shadow) * (1 - share) + laid * share).astype(np.uint8)
