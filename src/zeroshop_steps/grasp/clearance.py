"""Whether a gripper has room: against the object on a straight approach, and above the table in each stable placement."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from zeroshop_steps.geometry.support.placements import Placement
from zeroshop_steps.grasp.gripper import Gripper

BEHIND_M = 0.10  # length of the straight approach; the gripper with what carries it is free that far behind the palm
TOUCH_M = 0.0015  # a point this near to the pad touches it, since rubber yields
CORNERS = np.array([[3 * ((number >> axis) & 1) + axis for axis in range(3)] for number in range(8)])
"""Where a box of six numbers has the coordinates of each of its corners."""


@dataclass(frozen=True)
class PadContact:
    """What the pads meet when they close, of N grasps.

    Attributes:
        free: (N,) bool, whether the open gripper touches nothing on its approach.
        excess_m: (N,) how far something between the fingers stands out beyond the contacts and stops a finger before it gets there.
        touching: (N,) the share of the points before the smaller pad's contact that touch it, 0 to 1.
    """

    free: np.ndarray
    excess_m: np.ndarray
    touching: np.ndarray


def check_object(
    points: np.ndarray, object_from_gripper: np.ndarray, widths_m: np.ndarray, openings_m: np.ndarray, gripper: Gripper, margin_m: float
) -> PadContact:
    """Move the open gripper to N grasps, then close it.

    Args:
        points: (P, 3) dense points of the whole surface, metres, object frame.
        object_from_gripper: (N, 4, 4).
        widths_m: (N,) between the contacts.
        openings_m: (N,) between the pads on the approach.
        margin_m: that the gripper keeps from the object all around.
    """
    boxes = gripper.boxes(openings_m, BEHIND_M)
    boxes[:, :, 0] -= margin_m
    boxes[:, :, 1] += margin_m
    # The pads' own faces: what they keep from the object is the opening beyond the width.
    boxes[:, 0, 0, 1] += margin_m
    boxes[:, 1, 1, 1] -= margin_m
    pad = np.array([gripper.finger_width_m / 2, gripper.tip_m - gripper.pad_length_m, gripper.tip_m])
    free, upper, lower, counts = _meet(
        np.ascontiguousarray(points, np.float64), np.ascontiguousarray(object_from_gripper, np.float64), boxes, pad, widths_m / 2, TOUCH_M
    )
    excess = np.maximum(np.maximum(upper, -lower) - widths_m / 2, 0.0)
    touching = counts[:, :2].min(1) / np.maximum(counts[:, 2:].max(1), 1)
    return PadContact(free, excess, np.minimum(touching, 1.0))


@njit(cache=True, parallel=True)
def _meet(points, object_from_gripper, boxes, pad, half_widths, touch_m):
    """(N,) free; (N,) the highest and (N,) the lowest y between the fingers; (N, 4) counts: touching and before either pad."""
    total = len(object_from_gripper)
    free, upper, lower = np.ones(total, np.bool_), np.zeros(total), np.zeros(total)
    counts = np.zeros((total, 4))
    for grasp in prange(total):
        r, box = object_from_gripper[grasp], boxes[grasp]
        shift_x = r[0, 0] * r[0, 3] + r[1, 0] * r[1, 3] + r[2, 0] * r[2, 3]
        shift_y = r[0, 1] * r[0, 3] + r[1, 1] * r[1, 3] + r[2, 1] * r[2, 3]
        shift_z = r[0, 2] * r[0, 3] + r[1, 2] * r[1, 3] + r[2, 2] * r[2, 3]
        xx, xy, xz, yx, yy, yz, zx, zy, zz = r[0, 0], r[1, 0], r[2, 0], r[0, 1], r[1, 1], r[2, 1], r[0, 2], r[1, 2], r[2, 2]
        finger_x, finger_low_z, tip_z = box[0, 1, 0], box[0, 0, 2], box[0, 1, 2]
        near, outer, far, farther = box[0, 0, 1], box[0, 1, 1], box[1, 1, 1], box[1, 0, 1]
        palm_x, palm_y, palm_low_z, palm_z = box[2, 1, 0], box[2, 1, 1], box[2, 0, 2], box[2, 1, 2]
        half = half_widths[grasp]
        highest, lowest, met = 0.0, 0.0, False
        touching_upper, touching_lower, before_upper, before_lower = 0, 0, 0, 0
        for index in range(len(points)):
            px, py, pz = points[index, 0], points[index, 1], points[index, 2]
            z = zx * px + zy * py + zz * pz - shift_z
            if z > tip_z:
                continue
            x = abs(xx * px + xy * py + xz * pz - shift_x)
            if x > finger_x and x > palm_x:
                continue
            y = yx * px + yy * py + yz * pz - shift_y
            in_finger = x < finger_x and z > finger_low_z and (near < y < outer or farther < y < far)
            if in_finger or (x < palm_x and abs(y) < palm_y and palm_low_z < z < palm_z):
                met = True
                break
            if x < pad[0] and far < y < near and palm_z < z < pad[2]:
                highest, lowest = max(highest, y), min(lowest, y)
                if z > pad[1] and y > 0:
                    before_upper += 1
                    touching_upper += y > half - touch_m
                elif z > pad[1]:
                    before_lower += 1
                    touching_lower += y < touch_m - half
        free[grasp], upper[grasp], lower[grasp] = not met, highest, lowest
        counts[grasp, 0], counts[grasp, 1], counts[grasp, 2], counts[grasp, 3] = touching_upper, touching_lower, before_upper, before_lower
    return free, upper, lower, counts


def check_table(
    placements: Sequence[Placement], object_from_gripper: np.ndarray, openings_m: np.ndarray, gripper: Gripper, margin_m: float
) -> np.ndarray:
    """(N, S) bool: whether the open gripper stays above the table on its approach, in each of S placements (metres).

    Args:
        margin_m: that it keeps from the table.
    """
    boxes = gripper.boxes(openings_m, BEHIND_M).reshape(len(openings_m), 3, 6)
    corners = boxes[:, :, CORNERS].reshape(len(openings_m), 24, 3)
    placed = np.einsum("nij,nkj->nki", object_from_gripper[:, :3, :3], corners) + object_from_gripper[:, None, :3, 3]
    heights = [placed @ placement.plane_from_object[2, :3] + placement.plane_from_object[2, 3] for placement in placements]
    return np.stack([height.min(1, initial=np.inf) > margin_m for height in heights], 1)
