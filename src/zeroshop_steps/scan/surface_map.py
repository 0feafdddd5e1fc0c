"""What planners of views ask of a map of the surface."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.scan.workspace import Box


@dataclass(frozen=True)
class Coverage:
    """How much of the surface is known.

    Attributes:
        surface: cells of the surface that is known, or assumed.
        well_seen: share of them, 0..1, that as many views as are wanted have seen within 60 degrees of their normals.
        unknown: cells at the border of what is known, behind which more surface may be.
    """

    surface: int
    well_seen: float
    unknown: int


class SurfaceMap(Protocol):
    """A map of the surface, which grows with each view."""

    def add_view(self, camera: Camera, depth_m: np.ndarray | None) -> None:
        """Take a view: a camera in metres and, if there is one, its (height, width) depth along the axis, 0 where nothing was measured."""

    def gains(self, cameras: Sequence[Camera]) -> np.ndarray:
        """(C,) what each camera would add, in cells of surface."""

    def coverage(self) -> Coverage:
        """How much is known."""

    def extent(self) -> Box:
        """What the object is known to be within."""
