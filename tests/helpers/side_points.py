"""Points of sides that images see, for models whose sides may lie on each other."""

from collections.abc import Sequence

import numpy as np
import pycolmap


def add_side_points(model: pycolmap.Reconstruction, places: np.ndarray, sides: Sequence[int], seen: Sequence[np.ndarray]) -> None:
    """Add the (S, P, 3) points of sides that at least two images see; image N, with id N + 1, sees `seen[N]`, (P,) bool, of `sides[N]`."""
    for side, points in enumerate(places):
        for index, place in enumerate(points):
            track = pycolmap.Track()
            for number, own in enumerate(sides):
                if own == side and seen[number][index]:
                    track.add_element(number + 1, index)
            if track.length() >= 2:
                model.add_point3D(place, track, np.zeros(3, np.uint8))
