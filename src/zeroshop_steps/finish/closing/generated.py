"""What no photo measured, proposed by a generated mesh: the underside and hollows.

The generated mesh is fitted to the measured surface by a similarity. Surface that is only assumed, such as the lid of a visual hull
over a plain hollow, gives way where the generated shape lies clearly deeper. Then the surface is closed in space (watertight.py), and
where photos say nothing the generated shape decides what is solid. Measured surface is never moved: vertices near it are put onto it
at the end. All that was added is a guess; its faces come last, are marked as never seen, and count in no figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.alignment.similarity_icp import SAMPLES, SimilarityRefiner
from zeroshop_steps.geometry.alignment.similarity_search import LEAST_SCALE_CHANGE
from zeroshop_steps.geometry.alignment.surface_distance import measure_distances
from zeroshop_steps.geometry.alignment.surface_points import SurfacePoints, sample_surface_points
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_points
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.support_classes import MEASURED
from zeroshop_steps.geometry.observation.vertex_support import classify_surface_support
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

LEAST_MEASURED = 0.1
"""Share of the surface that must be measured for a shape to be fitted to it."""
FARTHEST_DIAGONALS = 0.05
"""Mean distance of the generated from the measured surface beyond which it is another shape, in diagonals of the object."""
LID_DIAGONALS = 0.02
"""Assumed surface this far in front of the generated shape, in diagonals of the object, is a lid."""


class GeneratedShape:
    """A closed generated mesh, and on which side of it points lie."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self._scene = ray_caster((mesh.vertices, mesh.faces))

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(P,) bool: which of (P, 3) points are inside; far quicker than distances."""
        return self._scene.compute_occupancy(o3d.core.Tensor(points.astype(np.float32))).numpy() > 0

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """(P,) float32 distance of (P, 3) points, positive outside."""
        return self._scene.compute_signed_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()


@dataclass(frozen=True)
class Proposal:
    """A generated shape fitted to a measured mesh.

    Attributes:
        shape: the generated shape.
        measured: the mesh without the assumed surface that the shape contradicts, with normals.
        lids: share of the mesh's area that was assumed and gave way.
        distance: mean distance of the measured surface from the generated one.
    """

    shape: GeneratedShape
    measured: Mesh
    lids: float
    distance: float


def propose(mesh: Mesh, views: Sequence[View], confirmed: np.ndarray, generated: Mesh) -> Proposal:
    """Fit a generated mesh to a measured one, and take away the lids.

    Args:
        mesh: cleaned, in the frame of the views' cameras.
        views: registered photos with masks.
        confirmed: (N, 3) points that stereo confirmed.
        generated: in the same frame, roughly where it belongs; with colours or without.

    Raises:
        StepError: too little was measured, or the two are not the same shape.
    """
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    classed = Mesh(mesh.vertices, mesh.faces, quality=classify_surface_support(mesh, views, confirmed) / MEASURED)
    sure = classed.measured_faces()
    areas = mesh.face_areas()
    if areas[sure].sum() < LEAST_MEASURED * areas.sum():
        raise StepError(
            f"only {areas[sure].sum() / areas.sum():.0%} of the surface was measured, {LEAST_MEASURED:.0%} are needed to fit a generated"
            " mesh to it; use finish.unseen: smooth"
        )
    ours = sample_surface_points(Mesh(mesh.vertices, mesh.faces[sure]), SAMPLES, np.random.default_rng(0))
    placed_from_generated = _fit(generated, ours)
    placed = Mesh(transform_points(generated.vertices, placed_from_generated), generated.faces)
    distance, scale = float(measure_distances(placed, ours.points).mean()), compute_scale(placed_from_generated)
    if distance > FARTHEST_DIAGONALS * diagonal or not LEAST_SCALE_CHANGE < scale < 1 / LEAST_SCALE_CHANGE:
        raise StepError(
            f"the generated mesh, scaled by {scale:.2f}, lies {distance / diagonal:.1%} of the object's diagonal from the measured surface"
            f" in the mean; {FARTHEST_DIAGONALS:.0%} and a scale near 1 are allowed: it is another shape; use finish.unseen: smooth"
        )
    shape = GeneratedShape(placed)
    lid = ~sure & (shape.signed_distance(mesh.vertices[mesh.faces].mean(1)) > LID_DIAGONALS * diagonal)
    measured = Mesh(mesh.vertices, mesh.faces[~lid]).without_loose_vertices().with_normals()
    return Proposal(shape, measured, float(areas[lid].sum() / areas.sum()), distance)


def _fit(generated: Mesh, measured: SurfacePoints) -> np.ndarray:
    """The (4, 4) similarity that brings the generated surface onto the measured one, by shape, starting from where both are.

    The measured surface is what moves within the search: all of it must lie on the generated one, but not the other way round.
    """
    theirs = sample_surface_points(generated, 4 * SAMPLES, np.random.default_rng(0))
    bare = [SurfacePoints(points.points, points.normals, None) for points in (measured, theirs)]
    return np.linalg.inv(SimilarityRefiner(*bare).refine(np.eye(4)).transform)
