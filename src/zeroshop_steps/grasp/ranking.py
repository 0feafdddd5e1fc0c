"""Candidate grasps, their score, and a choice of the best that is spread over the object."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.grasp.contacts import ContactPairs, perpendicular
from zeroshop_steps.grasp.gripper import Gripper

APPROACHES = 16  # directions around the closing axis
LEVER_M = 0.05  # from the centre of mass to the middle of the contacts at which a grasp is worth a factor of e less
STOP_M = 0.002  # by how much something may stand out before the contacts; at twice that, a grasp is worth a factor of e^4 less
NEAR_M, NEAR_RAD = 0.02, np.radians(25)  # grasps nearer than this are alike
LIKENESS_COST = 0.8  # share of its score that a grasp loses in the choice if one just like it is chosen


@dataclass(frozen=True)
class Candidates:
    """Grasps before they are ranked.

    Attributes:
        object_from_gripper: (N, 4, 4) metres.
        pair: (N,) number of each one's pair of contacts.
    """

    object_from_gripper: np.ndarray
    pair: np.ndarray


def make_candidates(pairs: ContactPairs, gripper: Gripper, back_m: float = 0.0) -> Candidates:
    """The gripper with its tool centre point in the middle of each pair, from `APPROACHES` directions around its axis.

    With `back_m`, it stays back by so much along its approach, and the contacts are nearer to the fingertips.
    """
    across, along = perpendicular(pairs.axis)
    poses = []
    for angle in 2 * np.pi * np.arange(APPROACHES) / APPROACHES:
        approach = np.cos(angle) * across + np.sin(angle) * along
        pose = np.tile(np.eye(4), (len(pairs.axis), 1, 1))
        pose[:, :3, :3] = np.stack([np.cross(pairs.axis, approach), pairs.axis, approach], 2)
        pose[:, :3, 3] = pairs.middle - (gripper.tcp_m + back_m) * approach
        poses.append(pose)
    return Candidates(np.concatenate(poses), np.tile(np.arange(len(pairs.axis)), APPROACHES))


def balance_of(pairs: ContactPairs, centre: np.ndarray) -> np.ndarray:
    """(N,) 1 where the (3,) centre of mass is midway between the contacts, less with the distance: its weight turns the object.

    About the closing axis it turns in the fingers; across that axis, it pries them open.
    """
    return np.exp(-np.linalg.norm(centre - pairs.middle, axis=1) / LEVER_M)


def fit_of(excess_m: np.ndarray) -> np.ndarray:
    """(N,) 1 where nothing stands out before the contacts, so that the fingers meet the object just there."""
    return np.exp(-((excess_m / STOP_M) ** 2))


def combine(measures: dict[str, np.ndarray]) -> np.ndarray:
    """(N,) scores: the geometric mean of measures, each 0 to 1, so that one bad one spoils a grasp."""
    return np.exp(np.mean([np.log(np.clip(values, 1e-3, 1.0)) for values in measures.values()], axis=0))


def choose_spread(poses: np.ndarray, tcp_m: float, scores: np.ndarray, count: int, above: np.ndarray | None = None) -> np.ndarray:
    """Numbers of at most `count` grasps, the best score first: good ones that are not all alike.

    Args:
        poses: (N, 4, 4) object_from_gripper, metres.
        tcp_m: z of the tool centre point.
        scores: (N,) 0 to 1.
        above: (N, S) bool, in which of S placements the table leaves room for a grasp; half of the grasps are then shared out among
            the placements, so that there are some for each.
    """
    chosen: list[int] = []
    for placement in range(0 if above is None else above.shape[1]):
        assert above is not None
        there = np.setdiff1d(np.flatnonzero(above[:, placement]), chosen)
        chosen += there[_choose_unlike(poses[there], tcp_m, scores[there], max(1, count // (2 * above.shape[1])))].tolist()
    rest = np.setdiff1d(np.arange(len(scores)), chosen)
    chosen += rest[_choose_unlike(poses[rest], tcp_m, scores[rest], count - len(chosen))].tolist()
    return np.array(sorted(chosen[:count], key=lambda number: -scores[number]), int)


def _choose_unlike(poses: np.ndarray, tcp_m: float, scores: np.ndarray, count: int) -> list[int]:
    """Numbers of at most `count` grasps, chosen one by one; each costs those like it a part of their score (maximal marginal relevance).

    The gripper is the same turned by half about its approach, so its closing axis counts without its sign.
    """
    tcp = poses[:, :3, 3] + tcp_m * poses[:, :3, 2]
    worth = scores.copy()
    chosen: list[int] = []
    likest = np.zeros(len(scores))
    for _ in range(max(0, min(count, len(scores)))):
        best = int(worth.argmax())
        chosen.append(best)
        angle = np.arccos(np.clip(poses[:, :3, 2] @ poses[best, :3, 2], -1, 1))
        turn = np.arccos(np.clip(np.abs(poses[:, :3, 1] @ poses[best, :3, 1]), 0, 1))
        distance = np.linalg.norm(tcp - tcp[best], axis=1)
        likest = np.maximum(likest, np.exp(-((distance / NEAR_M) ** 2) - (angle**2 + turn**2) / NEAR_RAD**2))
        worth = scores * (1 - LIKENESS_COST * likest)
        worth[chosen] = -1.0
    return chosen
