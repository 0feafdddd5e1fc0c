"""Grasps of an object and their files: a JSON, and an array as the HSR's grasping pipeline reads it.

Both are in metres, in the object's frame (that of the mesh, but in metres). The array is (N, 1, 16) float64: row-major (4, 4)
object_from_gripper, the best grasp first, as in the annotations of v4r-tuwien/grasping_pipeline: z approaches, y closes (gripper.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write, read_json, write_json

FRAME_TEXT = "object_from_gripper, row-major 4x4, metres, object frame of the mesh; gripper: z approaches, y closes, x = y cross z"


@dataclass(frozen=True)
class Grasp:
    """One grasp.

    Attributes:
        object_from_gripper: (4, 4) rigid, metres: where the gripper's frame is in the object's when the fingers close.
        width_m: the distance between the surfaces that the fingers touch.
        contact_m: z of the contacts in the gripper's frame; at the tool centre point, or nearer to the fingertips.
        score: 0 to 1, the best first; what it is made of is in `measures`.
        placements: numbers of the stable placements (in the file's list) in which the table leaves room for the gripper.
        measures: by name, each 0 to 1.
    """

    object_from_gripper: np.ndarray
    width_m: float
    contact_m: float
    score: float
    placements: tuple[int, ...] = ()
    measures: dict[str, float] = field(default_factory=dict)

    @property
    def approach(self) -> np.ndarray:
        """(3,) unit direction in which the gripper moves to the object, in the object's frame."""
        return self.object_from_gripper[:3, 2]


def write_grasps(path: Path, grasps: Sequence[Grasp], facts: dict[str, Any]) -> None:
    """Write `path` (JSON) and the array beside it, `.npy`. The JSON is written last: if it exists, both do.

    Args:
        path: ends in `.json`.
        grasps: the best first.
        facts: what else the JSON says, such as the gripper and the placements.
    """
    array = np.array([grasp.object_from_gripper for grasp in grasps], np.float64).reshape(-1, 1, 16)
    with atomic_write(path.with_suffix(".npy")) as temporary, temporary.open("wb") as file:
        np.save(file, array)
    entries = [
        {
            "object_from_gripper": [round(float(value), 7) for value in grasp.object_from_gripper.reshape(-1)],
            "width_m": round(grasp.width_m, 6),
            "contact_m": round(grasp.contact_m, 6),
            "score": round(grasp.score, 5),
            "placements": list(grasp.placements),
            "measures": {name: round(value, 4) for name, value in grasp.measures.items()},
        }
        for grasp in grasps
    ]
    write_json(path, {"unit": "metre", "frame": FRAME_TEXT, **facts, "grasps": entries})


def read_grasps(path: Path) -> list[Grasp]:
    """The grasps of a JSON that `write_grasps` wrote, the best first.

    Raises:
        StepError: the file is missing or damaged.
    """
    record = read_json(path)
    try:
        return [
            Grasp(
                np.array(entry["object_from_gripper"], float).reshape(4, 4),
                float(entry["width_m"]),
                float(entry["contact_m"]),
                float(entry["score"]),
                tuple(entry["placements"]),
                dict(entry["measures"]),
            )
            for entry in record["grasps"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise StepError(f"{path} holds no grasps ({type(error).__name__}: {error}); delete it and make it again") from None


def read_grasp_array(path: Path) -> np.ndarray:
    """(N, 4, 4) object_from_gripper of an array with 16 numbers a grasp, (N, 1, 16) or (N, 16).

    Raises:
        StepError: the file is missing or damaged, or its matrices are no rigid transforms in metres.
    """
    try:
        array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise StepError(f"{path} is no array of grasps ({error}); expected (N, 1, 16) numbers as a .npy file") from None
    if array.ndim not in (2, 3) or array.shape[-1] != 16 or not np.issubdtype(array.dtype, np.floating):
        raise StepError(f"{path} has the shape {array.shape} of {array.dtype}; expected (N, 1, 16) floating-point numbers")
    transforms = array.reshape(-1, 4, 4).astype(float)
    rotations = transforms[:, :3, :3]
    rigid = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0) < 0.01
    if not rigid or np.abs(transforms[:, :3, 3]).max(initial=0.0) > 3.0:
        raise StepError(f"{path} holds matrices that are no rigid transforms in metres; expected row-major 4x4 object_from_gripper")
    return transforms
