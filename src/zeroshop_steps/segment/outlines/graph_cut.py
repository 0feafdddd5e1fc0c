"""Cut an image into object and background, along its edges, by per-pixel evidence.

The relaxed labels u in [0, 1] minimize sum(u * cost) + sum(weight * |grad u|), a convex problem whose threshold at 1/2 is a
global optimum of the binary one (Chan, Esedoglu and Nikolova 2006; Unger et al. 2008), solved by primal-dual steps
(Chambolle and Pock 2011).
"""

import numba
import numpy as np

from zeroshop_steps.geometry.imaging.channels import sum_channels

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
    contrast = sum_channels(right**2) + sum_channels(below**2)
    typical = 2.0 * float(contrast.mean()) + 1e-6  # as GrabCut's beta (Rother et al. 2004)
    return (SMOOTHNESS * np.maximum(np.exp(-contrast / typical), LEAST_SMOOTHNESS)).astype(np.float32)


@numba.njit(fastmath=True, error_model="numpy", forceinline=True)
def _step_dual(row, right, below, p, q, weight, sigma):
    """Of one row of pixels: the dual variables towards the right and the lower neighbours, kept in a disk of the weight's radius."""
    for x in range(len(row)):
        a = p[x] + sigma * (right[x] - row[x])
        b = q[x] + sigma * (below[x] - row[x])
        scale = np.float32(1) / max(np.float32(1), np.sqrt(a * a + b * b) / weight[x])
        p[x], q[x] = a * scale, b * scale


@numba.njit(fastmath=True, error_model="numpy", forceinline=True)
def _step_primal(u, ahead, cost, p, from_left, q, from_above, tau):
    """Of one row of pixels: the labels, and the labels extrapolated."""
    for x in range(len(u)):
        old = u[x]
        divergence = p[x] - from_left[x] + q[x] - from_above[x]
        new = min(max(old + tau * (divergence - cost[x]), np.float32(0)), np.float32(1))
        u[x], ahead[x] = new, new + new - old


@numba.njit(cache=True, fastmath=True, error_model="numpy", nogil=True)
def _minimize(cost, weight, steps):
    """Rows are slices of flat arrays, so that the compiler takes many pixels at a time: five times as fast as two loops with conditions.

    Each row has one pixel more, and there is one row more, equal to the last: nothing flows out of the image.
    """
    height, width = cost.shape
    stride = width + 1
    u = np.where(cost < 0, np.float32(1), np.float32(0))
    ahead = np.zeros((height + 1) * stride, np.float32)
    p, q = np.zeros(height * stride + 1, np.float32), np.zeros((height + 1) * stride, np.float32)
    tau = sigma = np.float32(1 / np.sqrt(8.0))
    for y in range(height):
        ahead[y * stride : y * stride + width] = u[y]
    for _ in range(steps):
        ahead[width::stride] = ahead[width - 1 :: stride]
        ahead[height * stride :] = ahead[(height - 1) * stride : height * stride]
        for y in range(height):
            a, b, below = y * stride, y * stride + width, (y + 1) * stride
            _step_dual(
                ahead[a:b], ahead[a + 1 : b + 1], ahead[below : below + width], p[a + 1 : b + 1], q[below : below + width], weight[y], sigma
            )
        for y in range(height):
            a, b, below = y * stride, y * stride + width, (y + 1) * stride
            _step_primal(u[y], ahead[a:b], cost[y], p[a + 1 : b + 1], p[a:b], q[below : below + width], q[a:b], tau)
    return u
