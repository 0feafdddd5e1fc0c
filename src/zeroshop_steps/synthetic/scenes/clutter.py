"""Things lying close together on a table: each at rest as it would stand or lie, none touching another."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.support.placements import outermost_points
from zeroshop_steps.runtime.errors import StepError

# How things lie on a table is a choice, not a measurement: close together, so that they hide one another in part.
GAP_MM = 3.0  # between convex hulls, at least
FIRST_RADIUS_MM, RADIUS_STEP_MM, ATTEMPTS = 30.0, 1.5, 600  # of the disk in which a place is drawn; it grows with each attempt
DROP_RADIUS_MM, DROP_STEP_MM = 110.0, 10.0  # of the disk that things fall in, and by which one is raised until it touches none


@dataclass(frozen=True)
class RigidBody:
    """A thing's shape for placing it.

    Attributes:
        hull: (H, 3) corners of its convex hull, mm; others lie at most a fraction of a millimetre outside.
        vertices: (V, 3) those of the whole hull, to put it exactly onto the table.
        rests: (S, 3, 3) rotations in which it rests on a plane with normal z.
        likely: (S,) how likely a thrown one comes to rest in each (Goldberg et al. 1999, as trimesh computes it).
    """

    hull: np.ndarray
    vertices: np.ndarray
    rests: np.ndarray
    likely: np.ndarray


def make_body(vertices: np.ndarray) -> RigidBody:
    """From (V, 3) vertices in mm."""
    outer = vertices[ConvexHull(vertices).vertices]
    hull = outermost_points(outer)
    transforms, likely = trimesh.poses.compute_stable_poses(trimesh.convex.convex_hull(hull))
    return RigidBody(hull, outer, transforms[:, :3, :3], likely)


def choose_rest(body: RigidBody, rng: np.random.Generator) -> np.ndarray:
    """(4, 4) table_from_model: at rest above the origin, turned at random about z; half of those that can stand upright do."""
    upright = np.flatnonzero(body.rests[:, 2, 2] > 0.999)
    if len(upright) and rng.uniform() < 0.5:
        rest = upright[body.likely[upright].argmax()]
    else:
        rest = rng.choice(len(body.rests), p=body.likely / body.likely.sum())
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix() @ body.rests[rest]
    turned = body.vertices @ transform[:3, :3].T
    transform[:2, 3] = -(turned[:, :2].min(0) + turned[:, :2].max(0)) / 2
    transform[2, 3] = -turned[:, 2].min()
    return transform


def place_bodies(
    bodies: Sequence[RigidBody],
    rng: np.random.Generator,
    gap_mm: float = GAP_MM,
    accept: Callable[[int, np.ndarray], bool] = lambda index, table_from_model: True,
) -> list[np.ndarray]:
    """(4, 4) table_from_model of each body, in mm, z up, the table at 0: as near to the middle as a few tries find room.

    Args:
        bodies: the shapes.
        rng: of everything random.
        gap_mm: that convex hulls keep from each other, so that meshes never intersect.
        accept: asked last, with the body's index and its (4, 4) place; what it accepts is taken.

    Raises:
        StepError: a body finds no room.
    """
    placed: list[manifold3d.Manifold] = []
    transforms: list[np.ndarray] = []
    for body in bodies:
        for attempt in range(ATTEMPTS):
            transform = choose_rest(body, rng)
            radius_mm, angle = (FIRST_RADIUS_MM + RADIUS_STEP_MM * attempt) * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
            transform[:2, 3] += radius_mm * np.array([np.cos(angle), np.sin(angle)])
            shape = manifold3d.Manifold.hull_points(transform_points(body.hull, transform))
            if all(shape.min_gap(other, gap_mm) >= gap_mm for other in placed) and accept(len(transforms), transform):
                placed.append(shape)
                transforms.append(transform)
                break
        else:
            raise StepError(f"no room on the table for body {len(transforms)} of {len(bodies)}; ask for fewer objects")
    return transforms


def drop_bodies(bodies: Sequence[RigidBody], rng: np.random.Generator) -> list[np.ndarray]:
    """(4, 4) table_from_model of each body, in mm: above the table and turned at random, none touching another, to fall from there."""
    placed: list[manifold3d.Manifold] = []
    transforms = []
    for body in bodies:
        transform = np.eye(4)
        transform[:3, :3] = Rotation.random(random_state=rng).as_matrix()
        turned = body.vertices @ transform[:3, :3].T
        radius_mm, angle = DROP_RADIUS_MM * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
        transform[:2, 3] = radius_mm * np.array([np.cos(angle), np.sin(angle)]) - (turned[:, :2].min(0) + turned[:, :2].max(0)) / 2
        transform[2, 3] = DROP_STEP_MM - turned[:, 2].min()
        shape = manifold3d.Manifold.hull_points(transform_points(body.hull, transform))
        while not all(shape.min_gap(other, GAP_MM) >= GAP_MM for other in placed):
            transform[2, 3] += DROP_STEP_MM
            shape = shape.translate([0.0, 0.0, DROP_STEP_MM])
        placed.append(shape)
        transforms.append(transform)
    return transforms
