"""Views of an object whose outlines alone are known: what is seen, and six numbers for where from.

A view is six numbers: azimuth and elevation of its axis, roll, where the object's centre lies beside the middle of its mask (two
tangents of angles), and the logarithm of the distance. The unit is the usual distance, the origin the object's centre, z up.
"""

from typing import NamedTuple

import numba
import numpy as np

UNKNOWNS = 6  # numbers of a view: three for its turn, three for its place


class Outlines(NamedTuple):
    """The outlines of N views, in units of the focal length that was guessed.

    Attributes:
        corners: (N, V, 2) corners of their convex hulls, relative to the principal point.
        counts: (N,) how many each has.
        middle: (N, 2) of the masks' bounding boxes.
        size: radius of the object, as seen from the usual distance.
        rims: (N, M, 2) points on the rims, spread evenly.
        distance: (N, H, W) float32 signed distances to the rims, px per 1000 px of the image, positive inside; of small copies.
        scale: (N,) pixels of the small copy per unit; principal: (N, 2) its principal point, in these pixels.
    """

    corners: np.ndarray
    counts: np.ndarray
    middle: np.ndarray
    size: float
    rims: np.ndarray
    distance: np.ndarray
    scale: np.ndarray
    principal: np.ndarray


@numba.njit(cache=True, forceinline=True)
def pose_view(view, log_focal, middle, pose):
    """Fill (15,) `pose`: rotation (9) and translation (3) of camera_from_world, and the centre (3)."""
    ca, sa, ce, se = np.cos(view[0]), np.sin(view[0]), np.cos(view[1]), np.sin(view[1])
    cr, sr = np.cos(view[2]), np.sin(view[2])
    right, down, ahead = (-sa, ca, 0.0), (se * ca, se * sa, -ce), (-ce * ca, -ce * sa, -se)
    for k in range(3):
        pose[k] = cr * right[k] + sr * down[k]
        pose[3 + k] = -sr * right[k] + cr * down[k]
        pose[6 + k] = ahead[k]
    distance, narrower = np.exp(view[5]), np.exp(-log_focal)
    pose[9] = (middle[0] * narrower + view[3]) * distance
    pose[10] = (middle[1] * narrower + view[4]) * distance
    pose[11] = distance
    for k in range(3):
        pose[12 + k] = -(pose[k] * pose[9] + pose[3 + k] * pose[10] + pose[6 + k] * pose[11])


@numba.njit(cache=True, forceinline=True)
def pose_views(views, log_focal, placed, outlines):
    """(N, 15) poses of the placed views."""
    poses = np.zeros((len(outlines.counts), 15))
    for number in placed:
        pose_view(views[number], log_focal, outlines.middle[number], poses[number])
    return poses
