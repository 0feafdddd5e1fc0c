"""What every registration method writes, also when it fails.

A registration that succeeded is a folder with images/, masks/ (where the capture has masks), sparse/ and
registration.json. One that failed raises. Where its failure is recorded (failures.py), a registration.json that says `failed` and
why, with the figures so far, is beside the record; a model that was found and rejected is in rejected/.
"""

import shutil
import time
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, Self

import pycolmap

from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import read_json, write_json

SCENES = ("su_l", "su_h", "su_b", "se", "video", "video_segmented")
OBJECT_ONLY = ("se", "video_segmented")
"""Scenes that are registered by the object alone: there is no ground, or the object was turned on it."""
PHOTO_SCENES = ("video", "video_segmented")
"""Scenes of the user's own photos."""
FEWEST_OF_PASS = 8  # images that lie together at one end of a capture and have no place: they may show the object turned over


class RegistrationFailed(StepError):
    """The images could not be registered; `figures` says what was found, `rejected` is the model, if there is one."""

    def __init__(self, reason: str, figures: Mapping[str, Any], rejected: pycolmap.Reconstruction | None = None) -> None:
        super().__init__(reason)
        self.figures, self.rejected = dict(figures), rejected

    def because(self, reason: str) -> Self:
        """The same failure with another reason."""
        return type(self)(reason, self.figures, self.rejected)

    def after(self, record: "Record") -> Self:
        """The same failure with what was found before, too."""
        return type(self)(str(self), {**record.entries, **self.figures}, self.rejected)

    def write_details(self, folder: Path) -> None:
        """Write the figures and the rejected model."""
        if self.rejected is not None:
            write_reconstruction(self.rejected, folder / "rejected")
        write_json(folder / "registration.json", {"status": "failed", "reason": str(self), **self.figures})


class TooFewRegistered(RegistrationFailed):
    """Too few images match."""


class Inconsistent(RegistrationFailed):
    """The model fits in itself, but something that had no part in it says that it is wrong."""


class DuplicateStructure(Inconsistent):
    """Distinct sides of the object that look alike were laid onto each other."""


@dataclass(frozen=True)
class Fault:
    """Why a model is refused: the reason for the user, and what is raised."""

    reason: str
    kind: type[RegistrationFailed] = RegistrationFailed


@dataclass(frozen=True)
class Finding:
    """What a check measured that speaks against a model. What all findings mean together is judged by verification/verdict.py.

    Attributes:
        measure: which of the verdict's measures it is.
        strength: 0 for cameras without any problem; at 1, this alone makes them about as likely wrong as right.
        found: the figures, in words for the user.
        images: names of those to blame, if single ones are.
    """

    measure: str
    strength: float
    found: str
    images: tuple[str, ...] = ()


@dataclass(frozen=True)
class Evidence:
    """What a check found.

    Attributes:
        entries: for registration.json.
        findings: what speaks against the model.
        fault: why the model is refused, whatever else is found; None where nothing does by itself.
        warnings: for the user.
    """

    entries: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    fault: Fault | None = None
    warnings: tuple[str, ...] = ()


class Stopwatch:
    """Seconds of the parts of a run, for its record."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._start_s = self._lap_s = time.monotonic()

    def lap(self, name: str) -> None:
        """The part `name` ends now."""
        self.seconds[name] = round(time.monotonic() - self._lap_s, 3)
        self._lap_s = time.monotonic()

    def stop(self) -> None:
        """All ends now."""
        self.seconds["total"] = round(time.monotonic() - self._start_s, 3)


@dataclass(frozen=True)
class Record:
    """What registration.json says so far. It is not changed: what adds to it returns another one."""

    entries: Mapping[str, Any] = field(default_factory=dict)
    stopwatch: Stopwatch = field(default_factory=Stopwatch)

    @staticmethod
    def begin(method: str, image_set: ImageSet, parameters: Any, *modules: ModuleType, **known: Any) -> "Record":
        """What is known before anything is computed: the method, its parameters (a dataclass), versions of modules, and what else is."""
        stopwatch = Stopwatch()
        begun = {"method": method, "images": len(image_set.images), "registered": 0, **known, "seconds": stopwatch.seconds}
        versions = {module.__name__: module.__version__ for module in modules}
        return Record({**begun, "parameters": asdict(parameters), "versions": versions}, stopwatch)

    def add(self, **entries: Any) -> "Record":
        """With these entries."""
        return Record({**self.entries, **entries}, self.stopwatch)

    def warn(self, *warnings: str) -> "Record":
        """With these warnings after those that are there."""
        return self.add(warnings=[*self.entries.get("warnings", []), *warnings]) if warnings else self

    def judge(self, evidence: Evidence, model: pycolmap.Reconstruction | None = None) -> "Record":
        """With what a check found; raises its fault, with `model` as the one that is refused."""
        record = self.add(**evidence.entries).warn(*evidence.warnings)
        if evidence.fault:
            raise record.fail(evidence.fault.reason, model, evidence.fault.kind)
        return record

    def fail(
        self, reason: str, model: pycolmap.Reconstruction | None = None, kind: type[RegistrationFailed] = RegistrationFailed
    ) -> RegistrationFailed:
        """The failure with all that is known; `model` is the one that is refused."""
        return kind(reason, self.entries, model)


def read_registration(cameras: Path) -> dict[str, Any]:
    """The record of a cameras folder. Raises StepError with the registration's own reason when it failed."""
    if failure := read_failure(cameras):
        raise StepError(f"{cameras}: registration failed ({failure.reason})")
    return read_json(Path(cameras) / "registration.json")


def describe_model(model: pycolmap.Reconstruction) -> dict[str, Any]:
    """Size and fit of a sparse model, as written to registration.json."""
    return {
        "registered": model.num_reg_images(),
        "points": model.num_points3D(),
        "reprojection_error_px": model.compute_mean_reprojection_error(),
        "mean_track_length": model.compute_mean_track_length(),
    }


def find_lens(record: Mapping[str, Any], stem: str) -> dict[str, Any] | None:
    """The lens of an image in a registration's record; None where the registration found none, or there was no distortion."""
    return record.get("lens") or record.get("lenses", {}).get(stem)


def find_missing(image_set: ImageSet, placed: Collection[str]) -> Evidence:
    """The images without a place, and a warning that names them as the user does."""
    missing = [name for name in image_set.names if name not in placed]
    if not missing:
        return Evidence({"unregistered": missing})
    shown = ", ".join(image_set.shown[name] for name in missing)
    reason = f"left out, {len(missing)} of {len(image_set.names)} photos have no sure place among the others: {shown}"
    if len(missing) >= FEWEST_OF_PASS and missing in (image_set.names[: len(missing)], image_set.names[-len(missing) :]):
        reason += (
            ". They were taken one after the other: if they show the object in another position, give them as a second input, so that"
            " both are joined (zeroshop FIRST SECOND)"
        )
    return Evidence({"unregistered": missing}, warnings=(reason,))


def move_contents(folder: Path, out: Path) -> None:
    """Move what an attempt wrote to where it belongs: one that fails leaves nothing there."""
    for part in folder.iterdir():
        shutil.move(part, out / part.name)
