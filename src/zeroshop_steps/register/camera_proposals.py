"""Proposals of cameras, one after the other in the order of their cost: the first that is good enough is taken, else the best.

What a proposal is worth is the share of the images that it places, times the probability that its cameras are right
(verification/verdict.py).
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import fit_similarity, read_sparse_model
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.register.scene.record import Record, RegistrationFailed, move_contents
from zeroshop_steps.runtime.errors import warn
from zeroshop_steps.runtime.files import scratch_directory

GOOD = 0.8
"""Worth from which on nothing else is tried: nearly sure cameras of 82 % of the images, or cameras of all that are right by 80 %."""
LEAST_COMMON, APART_SHARE = 5, 0.05
"""Two proposals agree where so many images stand in both, apart by at most this share of their distance from their middle."""


Fill = Callable[[Path, RegistrationFailed | None], dict[str, Any]]


@dataclass(frozen=True)
class Proposer:
    """A way to find cameras.

    Attributes:
        name: for the record and the user.
        fill: writes a cameras folder, and returns its record; raises RegistrationFailed. It is given what the one asked before failed by.
        mends: whether it can mend a failure: it is asked after such ones alone. None if it is asked anyway.
    """

    name: str
    fill: Fill
    mends: Callable[[RegistrationFailed], bool] | None = None


@dataclass(frozen=True)
class Proposal:
    """Cameras that passed the verdict."""

    name: str
    folder: Path
    record: dict[str, Any]

    @property
    def worth(self) -> float:
        """Share of the images with a camera, times the probability that these are right."""
        wrong = float(self.record.get("verdict", {}).get("wrong_probability", 0.0))
        return float((1 - wrong) * self.record["registered"] / self.record.get("images", self.record["registered"]))

    def describe(self) -> str:
        """For the user."""
        doubt = self.record.get("verdict", {}).get("wrong_probability", 0.0)
        placed = f"{self.record['registered']} of {self.record.get('images', self.record['registered'])} images registered"
        return f"{placed}, wrong by {100 * doubt:.0f} %" if doubt > 1 - GOOD else placed


def propose(out: Path, proposers: Sequence[Proposer], advice: str = "") -> dict[str, Any]:
    """Fill a folder with the first cameras that are good enough, else with the best.

    Args:
        out: folder to fill.
        proposers: in the order of their cost.
        advice: ends the reason where none succeeds.

    Returns:
        The record of the one that is kept, with `tried`: why the others were not, and how long they took.

    Raises:
        RegistrationFailed: none succeeded; with the figures and the model of the one that registered most images.
    """
    failures: dict[str, RegistrationFailed] = {}
    tried: dict[str, dict[str, Any]] = {}
    kept: Proposal | None = None
    failure: RegistrationFailed | None = None
    with scratch_directory(out, "proposals") as scratch:
        for number, proposer in enumerate(proposers):
            if proposer.mends and not (failure and proposer.mends(failure)):
                continue
            if tried:
                before = list(tried)[-1]
                how = "is doubtful" if failure is None else "failed"
                warn(f"registration by {before} {how} ({tried[before]['reason']}); trying {proposer.name}")
            start_s, folder = time.monotonic(), scratch / str(number)
            folder.mkdir()
            try:
                found = Proposal(proposer.name, folder, proposer.fill(folder, failure))
            except RegistrationFailed as error:
                failure, reason = error, str(error)
                if not proposer.mends:
                    failures[proposer.name] = error
            else:
                failure = None
                kept, reason = _choose(kept, found) if kept else (found, found.describe())
            tried[proposer.name] = {"reason": reason, "seconds": round(time.monotonic() - start_s, 3)}
            if kept and kept.worth >= GOOD:
                break
        if kept is not None:
            del tried[kept.name]
            move_contents(kept.folder, out)
            return kept.record | {"tried": tried}
    best = max(failures.values(), key=lambda error: error.figures.get("registered", 0))
    reason = "; ".join(f"by {name}: {error}" for name, error in failures.items()) if len(failures) > 1 else str(best)
    raise type(best)(reason + advice, best.figures | {"tried": tried}, best.rejected)


def _choose(kept: Proposal, other: Proposal) -> tuple[Proposal, str]:
    """The better one of two proposals, the first unless the other is worth more and agrees, and why."""
    if other.worth <= kept.worth:
        return kept, other.describe()
    if _agree(kept.folder, other.folder):
        return other, other.describe()
    doubt = f"the cameras by {kept.name} and by {other.name} contradict each other; one of them is wrong"
    warned = Record(kept.record).warn(f"{doubt}. Put the object on print, or take more photos")
    return Proposal(kept.name, kept.folder, dict(warned.entries)), doubt


def _agree(one: Path, other: Path) -> bool:
    """Whether the images that two registrations have in common stand alike in both."""
    first, second = (
        {camera.name: camera.centre_in_world for camera in read_sparse_model(folder / "sparse").cameras} for folder in (one, other)
    )
    common = sorted(first.keys() & second.keys())
    if len(common) < LEAST_COMMON:
        return False
    source, target = (np.array([centres[name] for name in common]) for centres in (first, second))
    apart = np.linalg.norm(transform_points(source, fit_similarity(source, target)) - target, axis=1)
    return bool(np.sqrt((apart**2).mean()) < APART_SHARE * np.linalg.norm(target - target.mean(0), axis=1).mean())
