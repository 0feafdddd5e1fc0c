"""The box that holds what is scanned, and its division into cells."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.runtime.errors import StepError

LEAST_SIDE_M, MOST_SIDE_M = 0.01, 2.0  # of a box around a thing that a hand can hold, or a robot can walk around


@dataclass(frozen=True)
class Box:
    """A box along the axes of the world, in metres; its bottom lies on what the object stands on.

    Attributes:
        low_m, high_m: (3,) corners.
    """

    low_m: np.ndarray
    high_m: np.ndarray

    @staticmethod
    def around(centre_m: np.ndarray, size_m: np.ndarray) -> "Box":
        """By its middle and its sides. Raises StepError for sides that are no box of a thing on a table."""
        centre, size = np.asarray(centre_m, float), np.asarray(size_m, float)
        if not (np.isfinite(centre).all() and np.isfinite(size).all() and (size >= LEAST_SIDE_M).all() and (size <= MOST_SIDE_M).all()):
            raise StepError(
                f"the box around the object has the middle {centre.tolist()} and the sides {size.tolist()} m; expected finite numbers, and"
                f" sides of {LEAST_SIDE_M:g} to {MOST_SIDE_M:g} m: metres, not millimetres"
            )
        return Box(centre - size / 2, centre + size / 2)

    @property
    def centre_m(self) -> np.ndarray:
        """(3,) its middle."""
        return np.asarray((self.low_m + self.high_m) / 2)

    @property
    def radius_m(self) -> float:
        """Of the ball around it."""
        return float(np.linalg.norm(self.high_m - self.low_m) / 2)

    def distance_m(self, points_m: np.ndarray) -> np.ndarray:
        """(...) of (..., 3) points from the box; 0 inside."""
        outside = np.maximum(np.maximum(self.low_m - points_m, points_m - self.high_m), 0.0)
        return np.asarray(np.linalg.norm(outside, axis=-1))

    def moved(self, target_from_world: np.ndarray) -> "Box":
        """The box around this one after a rigid (4, 4) motion: larger, where that turns it."""
        sides = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        corners = self.low_m + sides * (self.high_m - self.low_m)
        moved = corners @ target_from_world[:3, :3].T + target_from_world[:3, 3]
        return Box(moved.min(0), moved.max(0))


@dataclass(frozen=True)
class Grid:
    """Cubic cells that fill a box.

    Attributes:
        low_m: (3,) its first corner.
        cell_m: side of a cell.
        shape: cells along x, y and z.
    """

    low_m: np.ndarray
    cell_m: float
    shape: tuple[int, int, int]

    @staticmethod
    def fill(box: Box, cells: int) -> "Grid":
        """Cells for a box, so many along its longest side."""
        size = box.high_m - box.low_m
        cell_m = float(size.max()) / cells
        shape = np.maximum(np.ceil(size / cell_m - 1e-6).astype(int), 3)
        return Grid(box.low_m, cell_m, (int(shape[0]), int(shape[1]), int(shape[2])))

    def middles(self) -> np.ndarray:
        """(cells, 3) middles of all cells, in the order of a flattened array of this shape."""
        along = [low + (np.arange(count) + 0.5) * self.cell_m for low, count in zip(self.low_m, self.shape, strict=True)]
        return np.stack(np.meshgrid(*along, indexing="ij"), -1).reshape(-1, 3)

    def middles_of(self, cells: np.ndarray) -> np.ndarray:
        """(N, 3) middles of the cells of these numbers in a flattened array."""
        return np.stack(np.unravel_index(cells, self.shape), -1) * self.cell_m + (self.low_m + self.cell_m / 2)
