"""Keep the underside out of the space that photos look through, where an object touches its support in the middle alone.

The ends of a banana hang in the air. Extended flat down to the table, they would stand on walls that no mask allows. There the
underside is lifted to the lowest place that the masks allow: the lower side of the visual hull (Laurentini 1994).
"""

from collections.abc import Sequence

import cv2
import numpy as np

from zeroshop_steps.finish.closing.watertight import OUTSIDE_SHARE, OUTSIDE_VIEWS
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.meshes.surface_fields import build_neighbour_matrix
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

# Lengths in diagonals of the object's bounding box.
FAR_DIAGONALS = 0.01  # so far outside a mask tells an overhang: the plane, the cameras and the masks' feet are less exact than that
NEAR_DIAGONALS = 0.003  # so far outside a mask, a lifted underside may stay
STEP_DIAGONALS = 0.002  # between the heights that are tried
THICKNESS_DIAGONALS = 0.005  # that is left between the underside and the surface above it
FILLED_SHARE = 0.05
"""Of the added area, so much may be looked through. Rendered boxes, cans and bottles have 0 to 0.03, a torn glossy can 0.06; clamp, drill,
banana, and two toys whose feet stick out have 0.13 to 0.34."""
RAISING_STEPS, EVENING_STEPS = 10, 3  # more of the latter would lower the border again


def lift_underside(whole: Mesh, vertices: int, first_face: int, up: np.ndarray, views: Sequence[View]) -> Mesh:
    """The mesh with its underside lifted out of the space that photos look through; as it was where they hardly do.

    Args:
        whole: the mesh in the frame of the views' cameras, closed flat.
        vertices, first_face: how many of its vertices were measured, and the first face that was added.
        up: (3,) unit normal of the support plane, towards the object.
        views: registered photos with masks.
    """
    measured = Mesh(whole.vertices[:vertices], whole.faces[:first_face])
    diagonal = float(np.linalg.norm(np.ptp(measured.vertices, axis=0)))
    added = whole.faces[first_face:]
    areas = whole.face_areas()[first_face:]
    looked_through = _find_open(whole.vertices[added].mean(1), views, FAR_DIAGONALS * diagonal)
    if areas[looked_through].sum() <= FILLED_SHARE * areas.sum():
        return whole
    places = whole.vertices[vertices:]
    highest = _find_highest(places, measured, up, THICKNESS_DIAGONALS * diagonal)
    # A vertex of a border is joined with the one below it, which stays below.
    border, below = np.sort(added, axis=1)[:, [0, 2]].T
    walls = (border < vertices) & (below >= vertices)
    np.minimum.at(highest, below[walls] - vertices, (whole.vertices[border[walls]] - whole.vertices[below[walls]]) @ up)
    highest = np.maximum(highest, 0.0)
    tried = np.arange(0.0, highest.max() + STEP_DIAGONALS * diagonal, STEP_DIAGONALS * diagonal)
    above = (places[:, None] + tried[None, :, None] * up).reshape(-1, 3)
    is_open = _find_open(above, views, NEAR_DIAGONALS * diagonal).reshape(len(places), len(tried))
    is_open[:, -1] = False
    lift = tried[is_open.argmin(1)]  # the lowest that is not
    lift = _smooth(np.minimum(lift, highest), places, added[(added >= vertices).all(1)] - vertices, highest)
    return Mesh(np.concatenate([measured.vertices, places + lift[:, None] * up]), whole.faces).with_normals()


def _find_open(points: np.ndarray, views: Sequence[View], far: float) -> np.ndarray:
    """(P,) bool: which of (P, 3) points lie farther than `far` outside of the masks of enough views."""
    framed, outside = np.zeros((2, len(points)), np.int64)
    for view in views:
        mask = view.mask()
        off_px = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
        rows, columns, depth, shown = view.camera.find_pixels(points)
        framed += shown
        outside[shown] += off_px[rows[shown], columns[shown]] > far * view.camera.intrinsics[0, 0] / depth[shown]
    return (outside >= OUTSIDE_VIEWS) & (outside >= OUTSIDE_SHARE * framed)


def _find_highest(places: np.ndarray, measured: Mesh, up: np.ndarray, thickness: float) -> np.ndarray:
    """(P,) how far each of (P, 3) places may rise before it comes near the surface above it; what has none, to its highest point."""
    rays = np.concatenate([places, np.broadcast_to(up, places.shape)], axis=1).astype(np.float32)
    hits = ray_caster((measured.vertices, measured.faces)).cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    free = (measured.vertices @ up).max() - places @ up
    return np.asarray(np.where(np.isfinite(hits), hits - thickness, free), np.float64)


def _smooth(lift: np.ndarray, places: np.ndarray, faces: np.ndarray, highest: np.ndarray) -> np.ndarray:
    """Heights at (P, 3) places, vertices of (F, 3) faces, raised to the mean of their neighbours', then evened out, as far as they may."""
    near = build_neighbour_matrix(Mesh(places, faces))
    near.setdiag(0.0)  # the others alone
    count = np.maximum(np.asarray(near.sum(1)).ravel(), 1.0)
    for _ in range(RAISING_STEPS):
        lift = np.minimum(np.maximum(lift, near @ lift / count), highest)
    for _ in range(EVENING_STEPS):
        lift = np.minimum(0.5 * (lift + near @ lift / count), highest)
    return lift
