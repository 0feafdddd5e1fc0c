"""Find the symmetries of a shape: rotations about axes through its centroid that move no point away from its surface.

Colours do not count: a printed box has the symmetries of a box, which is right where its print cannot be told. As in BOP (Hodan et
al., ECCV 2018), a transform is a symmetry where it keeps the surface within a share of the diameter.
"""

from itertools import product

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.alignment.surface_points import sample_surface_points
from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

MOVED_DIAMETERS = 0.02  # how far from the surface a transform may move all but a hundredth of its points
FEW_SAMPLES, SAMPLES, DENSE_SAMPLES = 200, 1500, 40_000  # of the surface: points that are moved, and points that stand for it
ODD_TURNS = np.pi * np.array([0.11, 0.29, 0.47, 0.71, 0.93])  # a surface that these keep is one of revolution
WORSE = 2.0  # times as far as the best number of folds: a hexagon is nearly kept by a seventh of a turn, too
MOST_FOLDS = 12  # of a discrete rotation; finer ones are taken for a surface of revolution
MOST_TRANSFORMS = len(Rotation.create_group("I"))  # rotations of an icosahedron; more are an error of the tolerance
SAME_TURN_DEG = 5.0
LEAST_APART = 0.05  # of the spreads along principal axes, as a share; with equal ones, as of a prism, their directions are chance


def find_symmetries(mesh: Mesh, diameter_mm: float) -> dict[str, list]:
    """`symmetries_discrete` and `symmetries_continuous` of models_info.json; a key is left out where there are none.

    Args:
        mesh: in mm.
        diameter_mm: of the mesh.
    """
    shape = _Shape(mesh, diameter_mm)
    candidates = _candidate_axes(mesh)
    round_about = [axis for axis in candidates if shape.is_kept(Rotation.from_rotvec(ODD_TURNS[:, None] * axis))]
    found: dict[str, list] = {}
    turns: list[Rotation] = []
    if round_about:
        axes = np.eye(3) if len(round_about) > 1 else np.array(round_about)  # a ball turns about every axis
        found["symmetries_continuous"] = [{"axis": axis.tolist(), "offset": shape.centre.tolist()} for axis in axes]
        turns = _half_turn_across(shape, axes[0], 1) if len(axes) == 1 else []
    else:
        for axis in candidates:
            moved = {folds: shape.measure(Rotation.from_rotvec(2 * np.pi / folds * axis)) for folds in range(2, MOST_FOLDS + 1)}
            folds = max((n for n, mm in moved.items() if mm < min(shape.limit_mm, WORSE * min(moved.values()))), default=1)
            if folds > 1:
                turns += [Rotation.from_rotvec(2 * np.pi / folds * axis), *_half_turn_across(shape, axis, 90)]
    group = _close_group(turns)
    if group:
        found["symmetries_discrete"] = [shape.about_centre(turn).ravel().tolist() for turn in group]
    return found


class _Shape:
    """Points on a surface, and the test whether rotations about its centroid keep it."""

    def __init__(self, mesh: Mesh, diameter_mm: float) -> None:
        rng = np.random.default_rng(0)
        dense = sample_surface_points(mesh, DENSE_SAMPLES, rng).points
        corners, areas = mesh.vertices[mesh.faces].mean(1), mesh.face_areas()
        self.centre = np.average(corners, axis=0, weights=areas)
        self._points = dense[:SAMPLES] - self.centre
        self._tree, self.limit_mm = cKDTree(dense - self.centre), MOVED_DIAMETERS * diameter_mm

    def measure(self, turn: Rotation, count: int = SAMPLES) -> float:
        """How far a rotation moves all but a hundredth of the points from the surface, mm."""
        return float(np.quantile(self._tree.query(turn.apply(self._points[:count]))[0], 0.99))

    def is_kept(self, turns: Rotation) -> bool:
        """Whether all of these rotations keep the surface; few points rule most of them out."""
        return all(self.measure(turn, FEW_SAMPLES) < self.limit_mm and self.measure(turn) < self.limit_mm for turn in turns)

    def about_centre(self, turn: Rotation) -> np.ndarray:
        """(4, 4) the rotation about the centroid, mm."""
        return make_transform(turn.as_matrix(), self.centre - turn.apply(self.centre))


def _candidate_axes(mesh: Mesh) -> list[np.ndarray]:
    """Axes of the model's frame, and the principal axes of its surface where these are distinct."""
    corners, areas = mesh.vertices[mesh.faces].mean(1), mesh.face_areas()
    away = corners - np.average(corners, axis=0, weights=areas)
    spreads, principal = np.linalg.eigh((away * areas[:, None]).T @ away)
    apart = [np.delete(np.abs(spreads / one - 1), index).min() > LEAST_APART for index, one in enumerate(spreads)]
    turned = np.abs(principal).max(0) < np.cos(np.radians(SAME_TURN_DEG))
    return [*np.eye(3), *principal.T[np.array(apart) & turned]]


def _half_turn_across(shape: _Shape, axis: np.ndarray, steps: int) -> list[Rotation]:
    """The half turn about a line across an axis that keeps the shape best, if any does."""
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= np.linalg.norm(first)
    angles = np.arange(steps)[:, None] * np.pi / steps
    turns = [Rotation.from_rotvec(np.pi * line) for line in Rotation.from_rotvec(angles * axis).apply(first)]
    best = min(turns, key=lambda turn: shape.measure(turn, FEW_SAMPLES))
    return [best] if shape.is_kept(Rotation.concatenate([best])) else []


def _close_group(turns: list[Rotation]) -> list[Rotation]:
    """All different products of these rotations, without the identity; none where they make no small group."""
    group = [Rotation.identity()]
    grown = True
    while grown and len(group) <= MOST_TRANSFORMS:
        grown = False
        for one, other in list(product(group, turns)):
            turn = one * other
            if all((turn.inv() * known).magnitude() > np.radians(SAME_TURN_DEG) for known in group):
                group.append(turn)
                grown = True
    return group[1:] if len(group) <= MOST_TRANSFORMS else []
