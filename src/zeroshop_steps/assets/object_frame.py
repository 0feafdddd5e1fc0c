"""Registered cameras in the frame of the finished mesh, in metres."""

from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.meshes.metric_mesh import read_metric_mesh
from zeroshop_steps.geometry.meshes.units import M_PER_MM
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json


def read_object_from_registration(mesh: Path, unknown_scale: str) -> np.ndarray:
    """(4, 4) similarity from the frame and unit of the registration to the mesh's frame in metres.

    Args:
        mesh: the finished mesh with its JSON beside it.
        unknown_scale: as for `read_metric_mesh`, which refuses a mesh of unknown scale.

    Raises:
        StepError: the scale is unknown, or the JSON does not say how the mesh lies among the cameras.
    """
    read_metric_mesh(mesh, unknown_scale)
    record = mesh.with_suffix(".json")
    frame = read_json(record).get("frame_facts", {}).get("object_from_registration")
    if frame is None:
        raise StepError(f"{record} does not say how the mesh lies among the cameras (frame_facts); take the mesh of a cell")
    similarity = np.array(frame, float)
    similarity[:3] *= M_PER_MM
    return similarity
