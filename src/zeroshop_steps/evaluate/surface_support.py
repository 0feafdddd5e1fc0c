"""Classify every vertex of a finished mesh as measured, assumed or unseen; geometry/observation/vertex_support.py defines the classes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.support_classes import UNSEEN
from zeroshop_steps.geometry.observation.vertex_support import classify_surface_support
from zeroshop_steps.surface.mvs.seeds import read_confirmed_points


def classify_finished_mesh(
    mesh: Mesh, metadata: dict[str, Any], views: Sequence[View], stereo: Path | None, device: str = "cpu"
) -> np.ndarray:
    """(V,) uint8 class of each vertex.

    Args:
        mesh: in the object frame.
        metadata: content of mesh.json.
        views: the registered photos, in their own frame.
        stereo: seeds.npz with the depths that stereo confirmed, if there are any.
        device: where the mesh is rasterized.

    Raises:
        StepError: `stereo` is missing, damaged or of other cameras.
    """
    confirmed = read_confirmed_points(stereo, views) if stereo else np.zeros((0, 3))
    registration_from_object = np.linalg.inv(np.array(metadata["frame_facts"]["object_from_registration"]))
    registered = Mesh(transform_points(mesh.vertices, registration_from_object), mesh.faces)
    return drop_generated(classify_surface_support(registered, views, confirmed, device), mesh, metadata)


def drop_generated(evidence: np.ndarray, mesh: Mesh, metadata: dict[str, Any]) -> np.ndarray:
    """(V,) the classes, with vertices that only generated faces have, which are the mesh's last ones, as never seen.

    What a generated mesh proposed is never seen, whatever photos show.
    """
    if (metadata.get("closing") or {}).get("method") != "generated":
        return evidence
    kept = np.zeros(len(mesh.vertices), bool)
    kept[mesh.faces[: metadata["underside"]["first_face"]]] = True
    return np.where(kept, evidence, UNSEEN).astype(np.uint8)
