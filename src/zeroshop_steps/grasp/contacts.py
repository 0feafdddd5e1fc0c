"""Antipodal pairs of contacts: places on both sides of an object that two fingers can press without slipping (Nguyen 1988).

The line between the contacts must lie in the friction cone of both: within atan(friction) of their normals. A pair is robust if that
stays so when the fingers come down a little beside it, by as much as the surface and the pose are uncertain.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.grasp.surface import SAME_SIDE, GraspSurface

TILTS = 4  # axes that are tried at each sample: along the normal, and tilted at random within the friction cone
SHIFTS = 8  # directions in which a pair is shifted to see whether it is robust
START_M = 0.012  # in front of a contact, where a finger comes from; what lies nearer to the object stops it


@dataclass(frozen=True)
class ContactPairs:
    """Pairs of contacts, metres, object frame.

    Attributes:
        first, second: (N, 3) the contacts.
        axis: (N, 3) unit, from the first to the second: the closing direction.
        friction: (N,) 1 where the axis is along both normals, 0 where it is on the border of a friction cone.
        robustness: (N,) share of the shifted pairs that hold as well.
    """

    first: np.ndarray
    second: np.ndarray
    axis: np.ndarray
    friction: np.ndarray
    robustness: np.ndarray

    @property
    def width(self) -> np.ndarray:
        """(N,) distance between the contacts."""
        return np.linalg.norm(self.second - self.first, axis=1)

    @property
    def middle(self) -> np.ndarray:
        """(N, 3) the middle between the contacts."""
        return (self.first + self.second) / 2

    def at(self, index: np.ndarray) -> "ContactPairs":
        """Those at `index`, numbers or bool."""
        return replace(self, **{name: values[index] for name, values in vars(self).items()})


def find_contact_pairs(
    surface: GraspSurface, samples: int, largest_m: float, friction: float, shift_m: float, rng: np.random.Generator
) -> ContactPairs:
    """Antipodal pairs on the measured surface.

    Args:
        samples: how many first contacts are tried.
        largest_m: between the contacts, at most.
        friction: coefficient between pad and object.
        shift_m: by how much pairs are shifted along the surface to see whether they are robust.
        rng: for the choice of samples and of axes.
    """
    measured = np.flatnonzero(surface.measured)
    chosen = rng.choice(measured, min(samples, len(measured)), replace=False) if len(measured) else measured
    first = np.repeat(surface.points[chosen], TILTS, axis=0)
    normal = np.repeat(surface.normals[chosen], TILTS, axis=0)
    axis = _tilt(-normal, np.arctan(friction), np.tile(np.arange(TILTS) > 0, len(chosen)), rng)
    pairs = []
    for second, facing, there in (_exit(surface, first, axis, largest_m), _outermost(surface, first, axis, largest_m)):
        far_normal, far_measured = surface.smooth_normals_at(second, facing)
        angle = np.maximum(_angle(-axis, normal), _angle(axis, far_normal))
        good = there & far_measured & (angle < np.arctan(friction))
        pairs.append(ContactPairs(first[good], second[good], axis[good], 1 - angle[good] / np.arctan(friction), np.zeros(good.sum())))
    both = ContactPairs(**{name: np.concatenate([vars(one)[name] for one in pairs]) for name in vars(pairs[0])})
    both = both.at(_first_of_each(both))
    return replace(both, robustness=_robustness(surface, both, friction, shift_m))


def find_rim_pairs(surface: GraspSurface, wall_m: float, reach_m: float, samples: int, rng: np.random.Generator) -> ContactPairs:
    """Pairs through a wall whose inner side nobody saw, at the border of surface that is only assumed, as a lid over a hollow is.

    Args:
        wall_m: how thick the wall is taken to be; nothing is known of it.
        reach_m: of a contact from the assumed surface.
        samples: how many contacts, at most.
        rng: for their choice.
    """
    measured = np.flatnonzero(surface.measured)
    lid = surface.points[surface.assumed]
    distance, nearest = cKDTree(lid).query(surface.points[measured], distance_upper_bound=reach_m)
    near = np.isfinite(distance)
    measured, outward = measured[near], surface.points[measured[near]] - lid[nearest[near]]
    outer = np.einsum("nd,nd->n", outward, surface.normals[measured]) >= SAME_SIDE * np.linalg.norm(outward, axis=1)
    chosen = rng.permutation(measured[outer])[:samples]
    first, axis = surface.points[chosen], -surface.normals[chosen]
    return ContactPairs(first, first + wall_m * axis, axis, np.ones(len(chosen)), np.ones(len(chosen)))


def _exit(surface: GraspSurface, first: np.ndarray, axis: np.ndarray, largest_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The other side of the wall: (N, 3) places, (N, 3) outward normals, and (N,) whether it is within reach."""
    # The ray starts inside, where it meets the other side first.
    distance, facing = surface.cast(first + 1e-5 * axis, axis)
    there = (distance < largest_m) & (np.einsum("nd,nd->n", facing, axis) > 0)
    return first + np.where(there, distance, 0.0)[:, None] * axis, facing, there


def _outermost(surface: GraspSurface, first: np.ndarray, axis: np.ndarray, largest_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same for what a finger meets first that comes from the far end of the gripper's opening: the outer side of a hollow."""
    distance, facing = surface.cast(first + largest_m * axis, -axis)
    there = (distance < largest_m) & (np.einsum("nd,nd->n", facing, axis) > 0)
    return first + np.where(there, largest_m - distance, 0.0)[:, None] * axis, facing, there


def _first_of_each(pairs: ContactPairs) -> np.ndarray:
    """Numbers of the pairs without those that occur twice, as the other side of a wall and as the outermost."""
    key = np.rint(np.concatenate([pairs.first, pairs.second], 1) * 2e4).astype(np.int64)
    return np.sort(np.unique(key, axis=0, return_index=True)[1])


def _robustness(surface: GraspSurface, pairs: ContactPairs, friction: float, shift_m: float) -> np.ndarray:
    """(N,) share of `SHIFTS` directions in which both fingers, shifted, meet the surface within the friction cone."""
    held = np.zeros(len(pairs.first))
    across, along = perpendicular(pairs.axis)
    for angle in 2 * np.pi * np.arange(SHIFTS) / SHIFTS:
        shift = shift_m * (np.cos(angle) * across + np.sin(angle) * along)
        holds = np.ones(len(held), bool)
        for place, axis in ((pairs.first, pairs.axis), (pairs.second, -pairs.axis)):
            origins = place + shift - START_M * axis
            distance, facing = surface.cast(origins, axis)
            met = np.isfinite(distance) & (distance < 2 * START_M)
            normals, _ = surface.smooth_normals_at(origins + np.where(met, distance, 0.0)[:, None] * axis, facing)
            holds &= met & (_angle(-axis, normals) < np.arctan(friction))
        held += holds
    return held / SHIFTS


def perpendicular(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two (N, 3) unit vectors across each of (N, 3) unit vectors and across each other: axis x first = second."""
    helper = np.eye(3)[np.abs(axis).argmin(1)]
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(axis, first)


def _tilt(directions: np.ndarray, largest_rad: float, tilted: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) unit vectors, those that are `tilted` turned at random by up to `largest_rad`."""
    across, along = perpendicular(directions)
    turn, tilt = rng.uniform(0, 2 * np.pi, len(directions)), largest_rad * np.sqrt(rng.uniform(size=len(directions))) * tilted
    aside = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * along
    return np.cos(tilt)[:, None] * directions + np.sin(tilt)[:, None] * aside


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(N,) angles between unit vectors, radians."""
    return np.arccos(np.clip(np.einsum("nd,nd->n", first, second), -1.0, 1.0))
