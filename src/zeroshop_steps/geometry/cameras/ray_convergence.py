"""Where rays meet: the one point that several cameras look at."""

import numpy as np

LEAST_MISS = 1e-3  # share of the usual distance to the point: rays that pass closer get no more weight, which would be infinite


def find_nearest_point(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(3,) the point with the least sum of distances to rays, by iteratively reweighted least squares.

    Distances and not their squares count, so a few wrong rays hardly move the point.

    Args:
        origins: (N, 3) a point of each ray.
        directions: (N, 3) unit vectors along the rays, which reach to both sides.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None]
    weights = np.ones(len(origins))
    point = np.zeros(3)
    # The point no longer moves after so many rounds of reweighting.
    for _ in range(20):
        system = (across * weights[:, None, None]).sum(0)
        point = np.linalg.lstsq(system, (across @ origins[:, :, None] * weights[:, None, None]).sum(0)[:, 0], rcond=None)[0]
        miss = np.linalg.norm((across @ (point - origins)[:, :, None])[..., 0], axis=1)
        weights = 1.0 / np.maximum(miss, LEAST_MISS * np.median(np.linalg.norm(point - origins, axis=1)))
    return point
