"""Faults of pose estimates, detections and the benchmark's models."""

import atexit
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import cv2
import numpy as np

from helpers.faults import Fault, step
from helpers.small_dataset import CAN, make_dataset, true_estimates
from zeroshop_steps.bop.formats.estimates import Estimates, write_estimates

INFO, POSES = "models/models_info.json", "poses.csv"


@cache
def make_once() -> tuple[Path, Estimates]:
    """A small dataset and its true poses."""
    folder = Path(mkdtemp(prefix="faults."))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder, true_estimates(make_dataset(folder))


def score(folder: Path, spoil: Callable[[Path], object], estimates: Callable[[Estimates], Estimates] = lambda true: true) -> int:
    """Score perfect poses of a copy of the dataset that `spoil` has changed."""
    dataset, true = make_once()
    shutil.copytree(dataset, folder / "bop")
    write_estimates(folder / "bop" / POSES, estimates(true))
    spoil(folder / "bop")
    places = {"estimates": POSES, "targets": "test_targets_bop19.json", "scenes": "test", "models": "models"}
    return step("bop", "score_poses", out=folder / "scores.csv", **{name: folder / "bop" / place for name, place in places.items()})


def change_json(name: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    """Change the content of a JSON file of the dataset."""

    def spoil(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        changed = change(content)
        (folder / name).write_text(json.dumps(content if changed is None else changed))

    return spoil


def of_can(key: str, value: Any) -> Callable[[Path], None]:
    """One key of the can in models_info.json."""
    return change_json(INFO, lambda listed: listed[str(CAN)].update({key: value}))


def turning_about(axis: list[float]) -> Callable[[Path], None]:
    """The can turns about this axis."""
    return of_can("symmetries_continuous", [{"axis": axis, "offset": [0, 0, 0]}])


def mapped_by(matrix: np.ndarray) -> Callable[[Path], None]:
    """The can looks the same after this motion."""
    return of_can("symmetries_discrete", [matrix.ravel().tolist()])


def rewrite(name: str, change: Callable[[bytes], bytes]) -> Callable[[Path], object]:
    """Change the bytes of a file of the dataset."""
    return lambda folder: (folder / name).write_bytes(change((folder / name).read_bytes()))


def fill_file(name: str, content: bytes) -> Callable[[Path], object]:
    """Other content in a file of the dataset."""
    return rewrite(name, lambda old: content)


def scaled(factor: float) -> Callable[[Estimates], Estimates]:
    """Translations in another unit."""
    return lambda true: replace(true, translations_mm=true.translations_mm * factor)


def read_detection(folder: Path, segmentation: dict, image_id: int = 0) -> int:
    """Score one detection with this segmentation."""
    shutil.copytree(make_once()[0], folder / "bop")
    entry = {"scene_id": 1, "image_id": image_id, "category_id": 1, "score": 1.0, "bbox": [0, 0, 5, 5], "segmentation": segmentation}
    (folder / "found.json").write_text(json.dumps([entry]))
    places = {"targets": "test_targets_bop19.json", "scenes": "test"}
    options = {name: folder / "bop" / place for name, place in places.items()}
    return step("bop", "score_detections", detections=folder / "found.json", out=folder / "scores.csv", **options)


def nothing(folder: Path) -> None:
    """The dataset as it is."""


def with_depth(change: Callable[[np.ndarray], np.ndarray], suffix: str = ".png") -> Callable[[Path], None]:
    """Other depth images."""

    def spoil(folder: Path) -> None:
        for path in sorted((folder / "test/000001/depth").iterdir()):
            depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            path.unlink()
            cv2.imwrite(str(path.with_suffix(suffix)), change(depth))

    return spoil


def of_cameras(key: str, value: Any) -> Callable[[Path], None]:
    """One key of all images in scene_camera.json."""
    return change_json("test/000001/scene_camera.json", lambda listed: [camera.update({key: value}) for camera in listed.values()] and None)


CAN_NAME = r"object 2 in .*models_info\.json"
FAULTS = [
    *(
        Fault(f"a symmetry about {axis}", lambda folder, axis=axis: score(folder, turning_about(axis)), (CAN_NAME, "axis of length 1"))
        for axis in ([0, 0, 0], [0, 0, 2], [1, 1, 1])
    ),
    Fault(
        "a symmetry about NaN", lambda folder: score(folder, turning_about([float("nan"), 0, 1])), (r"models_info\.json: at 2", "finite")
    ),
    *(
        Fault(
            f"a discrete symmetry that {name}",
            lambda folder, matrix=matrix: score(folder, mapped_by(matrix)),
            (CAN_NAME, "no rigid motion"),
        )
        for name, matrix in (
            ("scales", np.diag([2.0, 2.0, 2.0, 1.0])),
            ("mirrors", np.diag([-1.0, 1.0, 1.0, 1.0])),
            ("is zero", np.zeros((4, 4))),
            ("shears", np.eye(4) + np.eye(4, k=1) * [[1], [0], [0], [0]]),
        )
    ),
    *(
        Fault(f"depth {name}", lambda folder, spoil=spoil: score(folder, spoil), says)
        for name, spoil, says in (
            (
                "of 8 bits",
                with_depth(lambda depth: (depth >> 8).astype(np.uint8)),
                (r"depth/000000\.png has 1 channel.* uint8", "16-bit PNG"),
            ),
            (
                "of floats",
                with_depth(lambda depth: depth.astype(np.float32), ".tif"),
                (r"000000\.tif has 1 channel.* float32", "16-bit PNG"),
            ),
            ("in another format", with_depth(lambda depth: depth, ".pgm"), (r"000000\.pgm is of a format that is not read", r"\.png")),
            ("of half the size", with_depth(lambda depth: depth[::2, ::2]), (r"depth/000000\.png is \d+ x \d+ px, its colour", "align")),
            (
                "in micrometres",
                of_cameras("depth_scale", 1e3),
                ("scene 1, image 0 is .* mm in the median", r"correct depth_scale in .*\.json"),
            ),
            ("in metres", of_cameras("depth_scale", 1e-4), ("scene 1, image 0 is .* mm in the median", "metres", r"scene_camera\.json")),
        )
    ),
    Fault(
        "a camera for an image of width 1",
        lambda folder: score(folder, of_cameras("cam_K", [0.9, 0, 0.5, 0, 1.2, 0.5, 0, 0, 1])),
        (r"scene_camera\.json: cam_K of image 0 has the focal lengths 0\.9 and 1\.2", "pixels"),
    ),
    Fault(
        "detections in images of another test",
        lambda folder: read_detection(folder, {"size": [1, 2], "counts": [1, 1]}, image_id=77),
        (r"found\.json: none of the 1 detections names a target", "scene 1, image 77, object 1"),
    ),
    Fault("diameter 0", lambda folder: score(folder, of_can("diameter", 0)), (r"models_info\.json: at 2 / diameter", "minimum")),
    Fault(
        "a diameter in words", lambda folder: score(folder, of_can("diameter", "abc")), (r"models_info\.json: at 2 / diameter", "number")
    ),
    Fault(
        "models_info as a list", lambda folder: score(folder, change_json(INFO, lambda listed: [listed])), (r"models_info\.json", "object")
    ),
    Fault(
        "deeply nested JSON",
        lambda folder: score(folder, rewrite(INFO, lambda old: b"[" * 100_000)),
        (r"models_info\.json is nested deeper",),
    ),
    *(
        Fault(
            f"translations in {unit}",
            lambda folder, factor=factor: score(folder, nothing, scaled(factor)),
            (r"poses\.csv", f"looks like {unit}", "millimetres are expected"),
        )
        for unit, factor in (("centimetres", 0.1), ("micrometres", 1000.0), ("metres", 0.001))
    ),
    Fault(
        "objects behind the camera", lambda folder: score(folder, nothing, scaled(-1.0)), (r"poses\.csv", "behind the camera", "z forward")
    ),
    Fault(
        "another scene",
        lambda folder: score(folder, nothing, lambda true: replace(true, scene_ids=true.scene_ids + 48)),
        (r"poses\.csv: none of the 5 rows names a target", "names scene 49", "same test set"),
    ),
    Fault(
        "other images",
        lambda folder: score(folder, nothing, lambda true: replace(true, image_ids=true.image_ids + 1000)),
        (r"poses\.csv: none of the 5 rows names a target", "same test set"),
    ),
    *(
        Fault(
            f"a depth image that is {name}",
            lambda folder, content=content: score(folder, fill_file("test/000001/depth/000000.png", content)),
            (r"000000\.png cannot be read: it is empty, damaged", "export it again"),
        )
        for name, content in (("empty", b""), ("cut off", b"\x89PNG\r\n\x1a\n"))
    ),
    Fault(
        "one word of 20 MB",
        lambda folder: score(folder, rewrite(POSES, lambda old: old + b"1,0,1,1," + b"9" * 20_000_000)),
        (r"poses\.csv, line 7 is 20000008 bytes long", "17 numbers"),
    ),
    Fault(
        "a mask of 10^11 pixels",
        lambda folder: read_detection(folder, {"size": [1_000_000, 100_000], "counts": [100_000_000_000]}),
        (r"found\.json: entry 0", "1000000 x 100000 px, larger than any image"),
    ),
    Fault(
        "a mask that overflows 32 bits",
        lambda folder: read_detection(folder, {"size": [65_536, 65_536], "counts": [1 << 32]}),
        (r"found\.json: entry 0", "larger than any image"),
    ),
]
