"""Where a camera can be brought: what planners of views ask, and the simplest answer, limits of distance and height."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from zeroshop_steps.scan.workspace import Box


@dataclass(frozen=True)
class Move:
    """A way to a view.

    Attributes:
        world_from_camera: (4, 4) m, the view as it is reached: an arm may have turned it about its optical axis.
        cost: of the way, seconds of an arm or metres without one: what is less is nearer.
        waypoints_rad: postures of an arm from the next one to the last; none without an arm.
    """

    world_from_camera: np.ndarray
    cost: float
    waypoints_rad: tuple[np.ndarray, ...] = ()


class Reach(Protocol):
    """Knows where the camera can be brought from where it is."""

    def plan(self, world_from_cameras: np.ndarray) -> list[Move | None]:
        """The way to each of (N, 4, 4) views, in metres; None to those that cannot be reached."""


@dataclass(frozen=True)
class Limits:
    """Limits of an arm whose joints are not known, or of a person.

    Attributes:
        base_m: (3,) where the arm stands, or None.
        reach_m: how far from there the camera comes.
        lowest_m: height that the camera does not go below.
        keep_out: that it does not enter.
        world_from_camera: (4, 4) where the camera is; None where it is not known.
    """

    base_m: np.ndarray | None = None
    reach_m: float = np.inf
    lowest_m: float = -np.inf
    keep_out: Box | None = None
    world_from_camera: np.ndarray | None = None

    def plan(self, world_from_cameras: np.ndarray) -> list[Move | None]:
        """The views within the limits; their cost is the distance in a straight line."""
        places = world_from_cameras[:, :3, 3]
        good = places[:, 2] >= self.lowest_m
        if self.base_m is not None:
            good &= np.linalg.norm(places - self.base_m, axis=1) <= self.reach_m
        if self.keep_out is not None:
            good &= self.keep_out.distance_m(places) > 0
        start = places if self.world_from_camera is None else self.world_from_camera[:3, 3]
        costs = np.linalg.norm(places - start, axis=1)
        return [Move(view, float(cost)) if fine else None for view, cost, fine in zip(world_from_cameras, costs, good, strict=True)]
