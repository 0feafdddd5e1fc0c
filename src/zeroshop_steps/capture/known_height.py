"""The height of an object that is known beforehand: by a ruler, or of a rendered object."""

from pathlib import Path

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

HEIGHT_RANGE_M = (0.005, 3.0)  # of a height that a user gives; the table of photos has the same bounds


def read_known_height_m(path: Path, given_m: float | None = None) -> float | None:
    """The height that the user gives, or else that in capture.json; None where neither is known."""
    if given_m is not None:
        low, high = HEIGHT_RANGE_M
        if not low <= given_m <= high:
            hint = " (is it in centimetres or millimetres?)" if given_m > high else ""
            raise StepError(f"height {given_m:g} m is out of range{hint}; give the height in metres, {low:g} to {high:g}, or none")
        return given_m
    height_m = read_json(path).get("known_height_m")
    if height_m is None:
        return None
    if not isinstance(height_m, int | float) or not 0.001 <= height_m <= 10.0:
        raise StepError(f"{path}: known_height_m is {height_m}; expected metres between 0.001 and 10")
    return float(height_m)
