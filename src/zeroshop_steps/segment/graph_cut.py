"""Cut an image into object and background, along its edges, by per-pixel evidence.

The relaxed labels u in [0, 1] minimize sum(u * cost) + sum(weight * |grad u|), a convex problem whose threshold at 1/2 is a
global optimum of the binary one (Chan, Esedoglu and Nikolova 2006; Unger et al. 2008), solved by primal-dual steps
(Chambolle and Pock 2011).
"""

import numba
import numpy as np

SMOOTHNESS = 2.5
"""Cost of one pixel of boundary where the image is flat, in log odds. More loses thin parts, less leaves ragged masks."""
LEAST_SMOOTHNESS = 0.15
"""Share of that cost that remains across the strongest edges."""
STEPS = 150  # of the minimization; the labels no longer change then


def cut_image(evidence: np.ndarray, image: np.ndarray) -> np.ndarray:
    """(H, W) float32 in [0, 1], above 1/2 on the object.

    Args:
        evidence: (H, W) log odds of the object, positive on it.
        image: (H, W, 3) float32 RGB, 0 to 255.
    """
    return _minimize(np.ascontiguousarray(-evidence, np.float32), compute_edge_weights(image), STEPS)


def compute_edge_weights(image: np.ndarray) -> np.ndarray:
    """(H, W) float32 cost of a boundary between a pixel and its right and lower neighbours: low across edges of the image."""
    right = np.diff(image, axis=1, append=image[:, -1:])
    below = np.diff(image, axis=0, append=image[-1:])
    contrast = (right**2).sum(2) + (below**2).sum(2)
    typical = 2.0 * float(contrast.mean()) + 1e-6  # as GrabCut's beta (Rother et al. 2004)
    return (SMOOTHNESS * np.maximum(np.exp(-contrast / typical), LEAST_SMOOTHNESS)).astype(np.float32)


@numba.njit(cache=True, fastmath=True)
def _minimize(cost, weight, steps):
    height, width = cost.shape
    u = np.where(cost < 0, np.float32(1), np.float32(0))
    ahead = u.copy()
    p, q = np.zeros_like(u), np.zeros_like(u)
    tau = sigma = np.float32(1 / np.sqrt(8.0))
    for _ in range(steps):
        for y in range(height):
            for x in range(width):
                here = ahead[y, x]
                a = p[y, x] + sigma * (ahead[y, x + 1] - here) if x + 1 < width else np.float32(0)
                b = q[y, x] + sigma * (ahead[y + 1, x] - here) if y + 1 < height else np.float32(0)
                scale = max(np.float32(1), np.sqrt(a * a + b * b) / weight[y, x])
                p[y, x], q[y, x] = a / scale, b / scale
        for y in range(height):
            for x in range(width):
                divergence = p[y, x] + q[y, x]
                if x > 0:
                    divergence -= p[y, x - 1]
                if y > 0:
                    divergence -= q[y - 1, x]
                old = u[y, x]
                new = min(max(old + tau * (divergence - cost[y, x]), np.float32(0)), np.float32(1))
                u[y, x], ahead[y, x] = new, 2 * new - old
    return u
