"""The true object as physics knows it: convex parts, mass, centre of mass and inertia."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write


@dataclass(frozen=True)
class PhysicalBody:
    """A rigid body in metres, in the frame of the true model.

    Attributes:
        parts: (V, 3) corners of each convex part.
        mass_kg: true mass.
        centre_m: (3,) centre of mass.
        inertia: (3, 3) kg m2 about the centre, along the frame's axes.
    """

    parts: tuple[np.ndarray, ...]
    mass_kg: float
    centre_m: np.ndarray
    inertia: np.ndarray

    @property
    def corners(self) -> np.ndarray:
        """(V, 3) of all parts."""
        return np.concatenate(self.parts)


def write_body(path: Path, body: PhysicalBody) -> None:
    """Write a body as .npz."""
    starts = np.cumsum([0] + [len(part) for part in body.parts])
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, corners=body.corners, starts=starts, mass_kg=body.mass_kg, centre_m=body.centre_m, inertia=body.inertia)


def read_body(path: Path) -> PhysicalBody:
    """Read what `write_body` wrote. Raises StepError where the file is missing or damaged."""
    try:
        with np.load(path, allow_pickle=False) as content:
            parts = np.split(content["corners"], content["starts"][1:-1])
            return PhysicalBody(tuple(parts), float(content["mass_kg"]), content["centre_m"], content["inertia"])
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise StepError(f"{path} holds no physical body ({error}); make it with --method physical_model") from None
