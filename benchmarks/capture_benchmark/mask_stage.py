"""The stage of masks alone: `segment` as a command on a stored scene, measured, and its masks against the references."""

import hashlib
import json
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from capture_benchmark.commands import last_line, run_step
from capture_benchmark.inputs import find_inputs
from capture_benchmark.pictures import draw_masks
from capture_benchmark.references import read_references
from capture_benchmark.scores import UNEXPECTED, MaskScores, compare_masks, name_outcome
from capture_benchmark.table import Capture
from zeroshop_steps.geometry.imaging.images import list_images, write_image
from zeroshop_steps.runtime.code_version import code_version
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import read_json, write_json

PICTURE = "masks.jpg"


@dataclass(frozen=True)
class MaskCommand:
    """How masks are made.

    Attributes:
        method: of `segment`.
        options: its further words on the command line.
        threads: of numerical libraries; 0 leaves it to them.
    """

    method: str
    options: tuple[str, ...] = ()
    threads: int = 0

    @property
    def environment(self) -> dict[str, str]:
        """Variables for the step."""
        names = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS")
        return dict.fromkeys(names, str(self.threads)) if self.threads else {}


def run_masks(capture: Capture, command: MaskCommand, inputs: Path, out: Path) -> dict[str, Any]:
    """Make the masks of a capture in `out`/masks unless they are there, made by the same code from the same scene.

    Returns:
        status, wall_s, cpu_s, memory_mb of the step, of now or of then; only what `read_failure` finds where registration refused.
    """
    scene, folder, record = find_inputs(inputs, capture) / "scene", out / "masks", out / "masks.json"
    key = make_key(scene, command)
    if record.is_file() and (earlier := read_json(record)).get("key") == key:
        return earlier
    for place in (folder, out / PICTURE):
        shutil.rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)
    words: list[str | Path] = ["segment", "--method", command.method, "--scene", scene, "--out", folder]
    usage = run_step([*words, "--record-failure", f"{folder}/", *command.options], out / "masks.log", command.environment)
    facts: dict[str, Any] = {"key": key, **{name: round(value, 2) for name, value in asdict(usage).items()}}
    write_json(record, facts)
    return facts


def make_key(scene: Path, command: MaskCommand) -> str:
    """What the masks of a scene depend on: the scene's files, the command, files that it names, and the code behind it."""
    digest = hashlib.sha256(code_version(f"segment.{command.method}").encode())
    digest.update(json.dumps([command.method, command.options]).encode())
    named = [Path(word) for word in command.options if Path(word).is_file()]
    for path in [*named, *sorted(path for path in scene.rglob("*") if path.is_file())]:
        digest.update(f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def judge_masks(
    capture: Capture, command: MaskCommand, facts: dict[str, Any], data: Path, inputs: Path, drawn: Path, out: Path
) -> dict[str, Any]:
    """The capture's row of the results table; a picture of its masks is drawn beside."""
    stored, folder = find_inputs(inputs, capture), out / "masks"
    scene = stored / "scene"
    row = describe_capture(capture) | {"photos": len(list_images(stored / "capture" / "images")), "registered": 0}
    scores, refusal = MaskScores({}, 0), find_refusal(folder, facts["status"], out / "masks.log")
    if read_failure(scene) is None:
        registered = [path.stem for path in list_images(scene / "images")]
        references = read_references(capture, stored, data, drawn)
        row["registered"] = len(registered)
        scores = scores if refusal else compare_masks(folder / "masks", registered, references)
        write_image(out / PICTURE, draw_masks(scene, None if refusal else folder, references, scores.overlaps))
    figures = scores.describe("mask_iou")
    row["outcome"] = name_outcome(capture, refusal, figures["mask_iou_median"], figures["mask_iou_worst"])
    row |= {"reason": refusal or "", "left_out": scores.left_out, "references": len(scores.overlaps), **figures}
    return row | {name: facts[name] for name in ("wall_s", "cpu_s", "memory_mb")} | {"method": command.method}


def find_refusal(folder: Path, status: int, log: Path) -> str | None:
    """Why a step wrote no result into `folder`; None where it did. A step that broke has `scores.UNEXPECTED` in the reason."""
    if failure := read_failure(folder):
        return str(failure)
    if status or not folder.is_dir():
        return f"{UNEXPECTED}end: {last_line(log)}"
    return None


def describe_capture(capture: Capture) -> dict[str, Any]:
    """The first columns of a capture's row."""
    columns = {name: getattr(capture, name) for name in ("name", "object", "half", "kind", "setting")}
    return columns | {"expected": "|".join(capture.expected), "outcome": ""}
