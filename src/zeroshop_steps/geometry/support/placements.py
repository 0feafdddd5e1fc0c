"""Stable placements: how a body rests on a plane, and how likely a thrown one comes to rest so (Goldberg et al. 1999).

Only the convex hull touches the plane. Each face of it on which the body is stable is a placement, and a body that lands on another
face topples on until it is stable (trimesh computes both). Real surfaces are never quite flat, and round ones rest on any of many
faces, so placements that differ by a few degrees are one here.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.cameras.viewpoints import SAME_DIRECTION_DEG, spread_over_sphere

HULL_DIRECTIONS = 600  # in which a body's extreme points are taken for its convex hull
LEAST_STABILITY_DEG = 8.0  # what falls over on a table tilted by less does not stand
LEAST_PROBABILITY = 0.005  # rarer ones are left out
CONTACT_SHARE = 0.01  # of the hull's size: what lies closer to the plane carries the body, once it has settled
UPRIGHT_COS = 0.94  # of the angle between the object's z axis and the plane's normal, 20 degrees


@dataclass(frozen=True)
class Placement:
    """One way to rest on a plane.

    Attributes:
        plane_from_object: (4, 4) rigid, lengths in the mesh's unit. The plane is z = 0, z up, and the centre of mass is above the
            origin. Of all turns about z it has that which turns the object least, so upright ones keep the object's x axis.
        probability: that a body thrown at random comes to rest so; those of a body add up to 1.
        stability_deg: by how much the plane may be tilted in the worst direction before the body falls over.
    """

    plane_from_object: np.ndarray
    probability: float
    stability_deg: float

    @property
    def kind(self) -> str:
        """`upright`, `flipped` (upside down) or `lying`, by the object's z axis."""
        up = self.plane_from_object[2, 2]
        return "upright" if up > UPRIGHT_COS else "flipped" if up < -UPRIGHT_COS else "lying"


def placements_of_hull(vertices: np.ndarray, centre: np.ndarray) -> list[Placement]:
    """The stable placements of a body, the most likely first, from its (V, 3) vertices and its (3,) centre of mass, in their unit."""
    import trimesh

    outer = vertices[ConvexHull(vertices).vertices]
    hull = trimesh.convex.convex_hull(outermost_points(outer))
    transforms, likely = trimesh.poses.compute_stable_poses(hull, center_mass=centre)
    merged = _merge(-transforms[:, 2, :3], likely)  # the third row is the plane's normal in the object's frame
    total = sum(probability for _, probability in merged)
    return [_rest(down, probability / total, outer, centre) for down, probability in merged]


def outermost_points(outer: np.ndarray) -> np.ndarray:
    """The corners of a simpler convex hull: those that lie outermost in one of `HULL_DIRECTIONS` directions or along an axis.

    Args:
        outer: (H, 3) corners of the whole hull; those left out lie at most a fraction of a per cent of its size outside.
    """
    polar, azimuth = spread_over_sphere(HULL_DIRECTIONS)
    directions = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], 1)
    return outer[np.unique((outer @ np.concatenate([directions, np.eye(3), -np.eye(3)]).T).argmax(0))]


def _merge(downs: np.ndarray, likely: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """(3,) directions of the plane below and their probabilities, the most likely first; near ones count for the likeliest of them."""
    leaders: list[int] = []
    probabilities: list[float] = []
    for index in np.argsort(-likely, kind="stable"):
        near = [place for place, leader in enumerate(leaders) if downs[index] @ downs[leader] > np.cos(np.radians(SAME_DIRECTION_DEG))]
        if near:
            probabilities[near[0]] += float(likely[index])
        else:
            leaders.append(int(index))
            probabilities.append(float(likely[index]))
    order = sorted(range(len(leaders)), key=lambda place: -probabilities[place])
    kept = [place for place in order if probabilities[place] >= LEAST_PROBABILITY] or order[:1]
    return [(downs[leaders[place]], probabilities[place]) for place in kept]


def _rest(down: np.ndarray, probability: float, outer: np.ndarray, centre: np.ndarray) -> Placement:
    """The placement on the plane that lies in direction `down` of the object's frame."""
    plane_from_object = np.eye(4)
    plane_from_object[:3, :3] = _turn_down(down)
    turned = transform_points(outer, plane_from_object)
    middle = plane_from_object[:3, :3] @ centre
    plane_from_object[:3, 3] = [-middle[0], -middle[1], -turned[:, 2].min()]
    height = middle[2] - turned[:, 2].min()
    foot = turned[turned[:, 2] < turned[:, 2].min() + CONTACT_SHARE * float(np.ptp(outer, axis=0).max())][:, :2] - middle[:2]
    return Placement(plane_from_object, probability, float(np.degrees(np.arctan2(_distance_to_border(foot), height))))


def _turn_down(down: np.ndarray) -> np.ndarray:
    """(3, 3) the smallest rotation that turns a unit vector to -z; half a turn about x where it points to +z."""
    axis = np.cross(down, [0.0, 0.0, -1.0])
    sine = float(np.linalg.norm(axis))
    axis = axis / sine if sine > 1e-9 else np.array([1.0, 0.0, 0.0])
    return Rotation.from_rotvec(axis * np.arctan2(sine, -down[2])).as_matrix()


def _distance_to_border(foot: np.ndarray) -> float:
    """How far the origin lies inside the convex hull of (N, 2) points; 0 where it lies outside or these have no area."""
    if len(foot) < 3 or np.linalg.matrix_rank(foot - foot.mean(0), tol=1e-9 * max(1.0, float(np.abs(foot).max()))) < 2:
        return 0.0
    return max(0.0, float(-ConvexHull(foot).equations[:, 2].max()))
