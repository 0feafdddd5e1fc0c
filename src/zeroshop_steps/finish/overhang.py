"""Tell whether photos look through what a flat underside would fill: an object that touches its support in the middle alone.

The ends of a banana hang in the air. Extended down to the table, they would stand on walls that no mask allows.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from zeroshop_steps.finish.watertight import OUTSIDE_SHARE, OUTSIDE_VIEWS
from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.geometry.registered_views import View

FAR_DIAGONALS = 0.01
"""So far outside a mask, in diagonals of the object, counts: the plane, the cameras and the masks' feet are less exact than that."""
FILLED_SHARE = 0.05
"""Of the added area, so much may be looked through. Boxes, cans and bottles have 0 to 0.03; clamp, drill, banana, and two toys whose feet
stick out have 0.13 to 0.32."""


def fills_open_space(whole: Mesh, first_face: int, views: Sequence[View]) -> bool:
    """Whether photos see the background where faces were added.

    Args:
        whole: the mesh in the frame of the views' cameras; faces from `first_face` on were added.
        first_face: their first.
        views: registered photos with masks.
    """
    added = whole.faces[first_face:]
    middle = whole.vertices[added].mean(1)
    diagonal = float(np.linalg.norm(np.ptp(whole.vertices[whole.faces[:first_face]].reshape(-1, 3), axis=0)))
    framed, outside = np.zeros((2, len(middle)), np.int64)
    for view in views:
        mask = view.mask()
        off_px = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
        points, depth = view.camera.project(middle)
        shown = (depth > 0) & (points >= 0).all(1) & (points < mask.shape[::-1]).all(1)
        column, row = points[shown].astype(np.int64).T
        framed[shown] += 1
        outside[shown] += off_px[row, column] > FAR_DIAGONALS * diagonal * view.camera.intrinsics[0, 0] / depth[shown]
    open_space = (outside >= OUTSIDE_VIEWS) & (outside >= OUTSIDE_SHARE * framed)
    areas = whole.face_areas()[first_face:]
    return bool(areas[open_space].sum() > FILLED_SHARE * areas.sum())
