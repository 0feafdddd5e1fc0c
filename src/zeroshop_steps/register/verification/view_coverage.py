"""Measure from which directions the registered photos show the object, and advise what to film again."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.support.ground_plane import estimate_up_from_roll
from zeroshop_steps.geometry.support.scene_support import find_focus
from zeroshop_steps.runtime.errors import StepError

WIDE_GAP_DEG = 60.0
"""A wider gap in azimuth is warned of: matching works over 36 degrees and hardly over 72, and what no photo shows has no surface."""
NARROW_ELEVATIONS_DEG = 12.0  # all photos are from about one height
FLAT_DEG, STEEP_DEG = 10.0, 65.0
"""If all photos are lower than the first, none shows the top; if all are higher than the second, none shows the sides."""
LEAST_SPREAD_DEG = 20.0
"""Photos that all lie within this show one side of the object at best. Those of two turntables, whose cameras followed what stood still
behind them, lay within 11 and 15 degrees."""
LEAST_TURN_DEG = 60.0
"""The same where the background stood still, and cameras were found from what turned. Of a clothespin that turned all around, some features
stood still as well, and the cameras lay within 40 degrees."""
OVERHEAD_DEG = 80.0  # from so high up, a photo has no azimuth


@dataclass(frozen=True)
class ViewCoverage:
    """The directions of the cameras, seen from the object.

    Attributes:
        largest_gap_deg: widest range of azimuths around the object without a camera.
        gap_between: names of the images on either side of it, in the sense of rotation about up.
        elevations_deg: (lowest, highest) above the horizontal.
    """

    largest_gap_deg: float
    gap_between: tuple[str, str]
    elevations_deg: tuple[float, float]

    def advice(self) -> list[str]:
        """What to film again, one sentence for each fault."""
        found = []
        if self.largest_gap_deg > WIDE_GAP_DEG:
            first, second = self.gap_between
            found.append(
                f"too few directions: no photo within {self.largest_gap_deg:.0f} degrees around the object between {first} and {second}; "
                "film from there, too"
            )
        low, high = self.elevations_deg
        if high - low < NARROW_ELEVATIONS_DEG:
            found.append(f"too few directions: all photos are from about one height ({low:.0f} to {high:.0f} degrees); film a second round")
        if high < FLAT_DEG:
            found.append("no photo shows the top: film a round from higher up")
        if low > STEEP_DEG:
            found.append("all photos are from above: film a round from the side")
        return found


def measure_view_coverage(cameras: list[Camera]) -> ViewCoverage:
    """Azimuths and elevations around the point that all cameras look at; up is estimated from how the photos were held.

    Raises:
        StepError: the cameras look away from each other.
    """
    up, _ = estimate_up_from_roll([View(camera, Path(camera.name), None) for camera in cameras])
    azimuths, elevations = measure_directions(_find_looks(cameras), up)
    aside = np.flatnonzero(np.abs(elevations) < OVERHEAD_DEG)
    order = aside[np.argsort(azimuths[aside], kind="stable")]
    if len(order) < 2:
        return ViewCoverage(360.0, (cameras[0].name, cameras[-1].name), (float(elevations.min()), float(elevations.max())))
    gaps = np.diff(azimuths[order], append=azimuths[order[0]] + 360.0)
    widest = int(gaps.argmax())
    between = cameras[order[widest]].name, cameras[order[(widest + 1) % len(order)]].name
    return ViewCoverage(float(gaps[widest]), between, (float(elevations.min()), float(elevations.max())))


def measure_directions(looks: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) azimuths from 0 to 360 and elevations, in degrees, of (N, 3) unit directions from the object; azimuth 0 is any."""
    first = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    first /= np.linalg.norm(first)
    azimuths = np.degrees(np.arctan2(looks @ np.cross(up, first), looks @ first)) % 360.0
    return azimuths, np.degrees(np.arcsin(np.clip(looks @ up, -1.0, 1.0)))


def check_spread(cameras: list[Camera], least_deg: float = LEAST_SPREAD_DEG) -> None:
    """Raise StepError where all cameras see the object from nearly the same direction, within so many degrees."""
    try:
        looks = _find_looks(cameras)
    except StepError:
        return  # they look away from each other, which is told elsewhere
    spread_deg = float(np.degrees(np.arccos(np.clip((looks @ looks.T).min(), -1.0, 1.0))))
    if spread_deg < least_deg:
        raise StepError(
            f"the cameras of all {len(cameras)} photos see the object from nearly the same direction, within {spread_deg:.0f} degrees; go"
            " around it"
        )


def _find_looks(cameras: list[Camera]) -> np.ndarray:
    """(N, 3) directions from the point that all cameras look at to each of them."""
    looks = np.array([camera.centre_in_world for camera in cameras]) - find_focus(cameras)
    return np.asarray(looks / np.linalg.norm(looks, axis=1, keepdims=True))


def record_view_coverage(scene: Path) -> dict[str, Any]:
    """The entries of registration.json on the directions of a registered scene: figures and advice."""
    try:
        found = measure_view_coverage(list(read_sparse_model(scene / "sparse").cameras))
    except StepError as error:
        return {"directions": None, "advice": [str(error)]}
    figures = {
        "largest_gap_deg": round(found.largest_gap_deg, 1),
        "gap_between": list(found.gap_between),
        "elevations_deg": [round(value, 1) for value in found.elevations_deg],
    }
    return {"directions": figures, "advice": found.advice()}
