"""Measure how the object stands in the registration's frame: its up direction, its support, and its height above it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import SparseModel
from zeroshop_steps.geometry.cameras.registered_views import View, choose_standing
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.support.ground_plane import SupportPlane, estimate_up_from_roll, find_background_points, fit_support_plane
from zeroshop_steps.geometry.support.scene_support import find_scene_focus
from zeroshop_steps.runtime.errors import StepError

EDGE_PX = 1.0  # error of the object's edges in the photos
TOP_SHARE = 2e-4  # of the surface's area may lie above the measured top: spikes are no part of the object
FROM_POINTS, FROM_VIEWS = "points", "views"  # where the segmentation has its plane from
VIEWS_DEVIATION_DISTANCES = 0.002
"""Standard deviation of the place of a plane on which views agree, in distances of the cameras: the step in which it was searched."""
ROLL_DEVIATION_DEG = 1.5  # and of its normal, which comes from how photos were held: 0.6 and 1.5 degrees off in two films
LEAST_MEASURED = 0.05  # of the surface's area; if less of it was measured, all of it counts for the top


@dataclass(frozen=True)
class ObjectPose:
    """The object above its support, in units of the registration.

    Attributes:
        up: (3,) unit vector.
        bottom, top: positions along `up` of the support plane (without one, of the mesh's bottom) and of the top of the measured surface.
        top_of_mesh: the top including assumed surface.
        deviation: standard deviation of top minus bottom, from three parts: how the bounds change when half or twice as much of the
            surface may stick out, the plane's own, and `EDGE_PX`.
        plane: the support plane, None where there is none.
        roll_certainty: of an `up` that comes from the cameras' roll (0 to 1), None with a plane.
    """

    up: np.ndarray
    bottom: float
    top: float
    top_of_mesh: float
    deviation: float
    plane: SupportPlane | None
    roll_certainty: float | None = None

    @property
    def extent(self) -> float:
        """Height of the object."""
        return self.top - self.bottom


def measure_object_pose(mesh: Mesh, views: list[View], model: SparseModel, segmentation: Mapping[str, Any] | None = None) -> ObjectPose:
    """Find the support plane and measure the mesh above it.

    The plane is fitted to the sparse points around the object. Where the segmentation found too few of them for that, it is the plane on
    which the views agreed there; where they told nothing, there is none.

    Args:
        mesh: registration frame.
        views: the registered photos.
        model: their sparse points.
        segmentation: the record of masks that were found; None where they were given.

    Where the mesh has `quality`, only measured faces count for its top: the lid that masks leave over a plain hollow bulges above
    the rim.

    Raises:
        StepError: the mesh does not rise above its support plane.
    """
    source = (segmentation or {}).get("plane_from", FROM_POINTS)
    plane, standing = None, choose_standing(views)
    if source == FROM_POINTS:
        plane = fit_support_plane(model.points[find_background_points(model.points, views)], mesh.vertices, standing)
    elif source == FROM_VIEWS and segmentation:
        residual = VIEWS_DEVIATION_DISTANCES * find_scene_focus(model)[1]
        plane = SupportPlane(np.array(segmentation["plane"]["normal"]), segmentation["plane"]["offset"], 0, residual, ROLL_DEVIATION_DEG)
    return measure_above_plane(mesh, views, plane)


def measure_above_plane(mesh: Mesh, views: list[View], plane: SupportPlane | None) -> ObjectPose:
    """Measure the mesh above a plane; without one, from its own bottom along the up that is estimated from how photos were held."""
    up, certainty = (plane.normal, None) if plane else estimate_up_from_roll(choose_standing(views))
    heights = mesh.vertices @ up
    areas = mesh.face_areas()
    measured = areas * mesh.measured_faces()
    if measured.sum() < LEAST_MEASURED * areas.sum():
        measured = areas
    shares = (TOP_SHARE / 2, TOP_SHARE, TOP_SHARE * 2)
    lows, tops_of_mesh = zip(*(measure_robust_extent(heights, mesh, areas, share) for share in shares), strict=True)
    _, highs = zip(*(measure_robust_extent(heights, mesh, measured, share) for share in shares), strict=True)
    low, top_of_mesh, high = lows[1], tops_of_mesh[1], highs[1]
    low_deviation, high_deviation = abs(lows[2] - lows[0]) / 2, abs(highs[2] - highs[0]) / 2
    bottom = plane.offset if plane else low
    if high - bottom <= 0:
        raise StepError(
            "the mesh has no height above its support plane: the reconstruction is flat or stands on its head. Look at"
            " raw_mesh.ply and at the masks; take more pictures from all around, some from above, with more print under the object"
        )
    if plane:
        half_width = np.linalg.norm(np.ptp(mesh.vertices, axis=0)) / 2
        low_deviation = np.hypot(plane.residual / np.sqrt(max(plane.inliers, 1)), np.radians(plane.normal_deviation_deg) * half_width)
    centre = mesh.vertices.mean(0)
    depths = [(view.camera.project(centre[None])[1][0], view.camera.intrinsics[0, 0]) for view in views]
    edge = EDGE_PX * float(np.median([depth / focal_px for depth, focal_px in depths]))
    deviation = float(np.linalg.norm([low_deviation, high_deviation, edge]))
    return ObjectPose(up, float(bottom), high, top_of_mesh, deviation, plane, certainty)


def measure_robust_extent(heights: np.ndarray, mesh: Mesh, areas: np.ndarray, share: float) -> tuple[float, float]:
    """Lowest and highest of the (V,) heights, without spikes of up to `share` of the faces' (F,) areas at either end."""
    weights = np.zeros(len(heights))
    for corner in range(3):
        np.add.at(weights, mesh.faces[:, corner], areas / 3)
    order = np.argsort(heights)
    below = np.cumsum(weights[order]) / weights.sum()
    first, last = np.searchsorted(below, share), np.searchsorted(below, 1.0 - share)
    return float(heights[order[first]]), float(heights[order[min(int(last), len(order) - 1)]])
