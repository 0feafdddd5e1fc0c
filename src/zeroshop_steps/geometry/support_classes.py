"""What evidence.npz says of a mesh: unseen, assumed or measured. Apart from the step that finds it out, which loads much more."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.runtime.errors import StepError

UNSEEN, ASSUMED, MEASURED = 0, 1, 2
NAMES = ("unseen", "assumed", "measured")


def with_surface_support(mesh: Mesh, path: Path) -> Mesh:
    """The mesh with what the step `evidence` wrote of it as its quality.

    Raises:
        StepError: the file is absent, damaged or of another mesh.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            evidence = archive["evidence"]
    except (OSError, ValueError, KeyError) as error:
        raise StepError(f"{path} is not a whole file of evidence ({type(error).__name__}: {error}); delete it and make it again") from None
    if evidence.shape != (len(mesh.vertices),):
        raise StepError(f"{path} tells of {len(evidence)} vertices, its mesh has {len(mesh.vertices)}; make it again")
    return replace(mesh, quality=evidence / MEASURED)


def compute_area_shares(mesh: Mesh) -> dict[str, float]:
    """The share of the surface with each evidence, by name, of a mesh with quality."""
    area, quality = mesh.face_areas(), mesh.quality[mesh.faces]
    return {name: round(float(area @ (quality * MEASURED == kind).mean(1) / area.sum()), 5) for kind, name in enumerate(NAMES)}
