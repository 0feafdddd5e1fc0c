"""A few texels and views of them, coloured by a twin in NumPy, by the kernel, and, as a program in Numba's simulator, by that for CUDA.

The simulator has to be chosen before Numba is imported: NUMBA_ENABLE_CUDASIM=1 NUMBA_DISABLE_JIT=1 python few_texels.py OUT
"""

import sys

import numpy as np

from zeroshop_steps.finish.texturing.texel_colors import VotingView, make_texel_colors
from zeroshop_steps.geometry.observation.visibility import find_visible, sample_image

TEXELS, VERTICES, VIEWS, WIDTH_PX, HEIGHT_PX = 300, 40, 3, 24, 18
LEAST_VOTES, COVERED, BROAD_WEIGHT, TOLERANCE = 0.3, 0.2, 1e-3, 0.2
ROUNDS = ((LEAST_VOTES, np.inf), (0.0, COVERED))


def make_texels() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Corners, shares, vertices and broad colours. Some texels lie off the images and behind cameras."""
    rng = np.random.default_rng(7)
    shares = rng.dirichlet(np.ones(3), TEXELS).astype(np.float32)
    corners = rng.integers(0, VERTICES, (TEXELS, 3)).astype(np.int32)
    vertices = rng.uniform((-1.2, -0.9, 1.5), (1.2, 0.9, 2.5), (VERTICES, 3))
    vertices[0], vertices[1] = (0.0, 0.0, -9.0), (9.0, 0.0, 2.0)
    return corners, shares, vertices, rng.uniform(size=(VERTICES, 3)).astype(np.float32)


def make_views() -> list[VotingView]:
    """Views with holes in their depths, parts that hide others, and parts that are not trusted."""
    rng = np.random.default_rng(8)
    views = []
    for index in range(VIEWS):
        projection = np.array([[22.0, 0, 12.0, 3.0 * index], [0, 21.0, 9.0, -2.0 * index], [0, 0, 1, 0.1 * index]])
        depth = rng.choice([0.0, 1.6, 2.0, 3.0], (HEIGHT_PX, WIDTH_PX)).astype(np.float32)
        trust = np.maximum(rng.uniform(-0.5, 1.0, depth.shape), 0).astype(np.float32)
        image = rng.uniform(size=(*depth.shape, 3)).astype(np.float32)
        votes, corrections = rng.uniform(size=VERTICES), rng.normal(0.0, 0.1, (VERTICES, 3))
        views.append(VotingView(projection, image, trust, depth, votes.astype(np.float32), corrections.astype(np.float32)))
    return views


def color(device: str) -> tuple[np.ndarray, np.ndarray]:
    """Mean colours (TEXELS, 3) uint8 and weights (TEXELS,) float32 by two rounds of the views."""
    *texels, broad = make_texels()
    colors = make_texel_colors(device, *texels, TOLERANCE)
    for least_votes, covered in ROUNDS:
        colors.begin_round(least_votes, covered)
        for view in make_views():
            colors.add(view)
    return colors.finish(broad, BROAD_WEIGHT)


def color_by_twin() -> tuple[np.ndarray, np.ndarray]:
    """The same for all texels of a view at once, by the functions that judge vertices: colours (TEXELS, 3), not rounded, and weights."""
    corners, shares, vertices, broad = make_texels()

    def interpolate(values: np.ndarray) -> np.ndarray:
        return np.einsum("nc,nc...->n...", shares, values[corners])

    total, weight = np.zeros((TEXELS, 3)), np.zeros(TEXELS)
    for least_votes, covered in ROUNDS:
        is_open = weight < covered
        for view in make_views():
            projected = np.column_stack([interpolate(vertices), np.ones(TEXELS)]) @ view.projection.T
            pixels, depth = projected[:, :2] / projected[:, 2:], projected[:, 2]
            votes = interpolate(view.votes)
            strength = votes * sample_image(view.trust, pixels) * find_visible(pixels, depth, view.depth, TOLERANCE)
            strength[~is_open | (votes <= least_votes)] = 0.0
            total += strength[:, None] * (sample_image(view.image, pixels) + interpolate(view.corrections))
            weight += strength
    return (total + BROAD_WEIGHT * interpolate(broad)) / (weight + BROAD_WEIGHT)[:, None], weight


if __name__ == "__main__":
    means, weights = color("cuda")
    np.savez(sys.argv[1], means=means, weights=weights)
