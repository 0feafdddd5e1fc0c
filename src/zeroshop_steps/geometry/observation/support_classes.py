"""The classes of surface support: unseen, assumed or measured, and the file evidence.npz that holds them.

They are apart from vertex_support.py, which determines them, because that imports much more.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError

UNSEEN, ASSUMED, MEASURED = 0, 1, 2
CLASS_NAMES = ("unseen", "assumed", "measured")


def with_surface_support(mesh: Mesh, path: Path) -> Mesh:
    """The mesh with the classes in a file as its quality.

    Args:
        mesh: without quality.
        path: evidence.npz, as `evaluate --method finished_mesh` writes it.

    Raises:
        StepError: the file is missing, damaged or belongs to another mesh.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            evidence = archive["evidence"]
    except (OSError, ValueError, KeyError) as error:
        raise StepError(f"{path} is not a complete evidence file ({type(error).__name__}: {error}); delete it and make it again") from None
    if evidence.shape != (len(mesh.vertices),):
        raise StepError(f"{path} has {len(evidence)} vertices, its mesh has {len(mesh.vertices)}; make it again")
    return replace(mesh, quality=evidence / MEASURED)


def compute_area_shares(mesh: Mesh) -> dict[str, float]:
    """The share of the surface area in each class, by name, of a mesh with quality."""
    area, quality = mesh.face_areas(), mesh.require_quality()[mesh.faces]
    return {name: round(float(area @ (quality * MEASURED == kind).mean(1) / area.sum()), 5) for kind, name in enumerate(CLASS_NAMES)}
