"""Leave out pairs of images whose relative rotation contradicts those of the other pairs.

Sides of an object that look alike give pairs that pass every check of two views, with many sure matches. Around the object they do not
close: rotations chained along other pairs lead elsewhere. Rotations of all images are found that as many matches as possible agree
with: spanning trees of the pairs are drawn, likely ones first (RANSAC), the best one is refined over all pairs that agree with it
(Hartley et al., Rotation Averaging, IJCV 2013), and the other pairs are left out.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pycolmap
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from zeroshop_steps.register.matching.verified_matches import make_verification_options
from zeroshop_steps.register.scene.database import delete_pair, read_matches, read_places

AGREES_DEG = 25.0
"""Of a pair's rotation with that of its images: a focal length that is guessed 15 % too short bends rotations of 100 degrees by 12."""
CONTRADICTS_DEG = 70.0
"""Sides that look alike are 90 or 180 degrees apart. Between the limits are right matches of flat sides, whose rotation is ambiguous."""
TREES, ROUNDS = 200, 5

Pair = tuple[int, int]


def delete_contradicting_pairs(database: Path, seed: int) -> list[tuple[str, str]]:
    """Delete the pairs of a database whose rotation contradicts those of the others; returns the names of their images.

    Args:
        database: with verified matches; changed in place.
        seed: of RANSAC.
    """
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: image.name for image in opened.read_all_images()}
        rotations = _estimate_rotations(opened, seed)
        wrong = sorted(find_contradicting(rotations, seed))
        for first, second in wrong:
            delete_pair(opened, first, second)
    return [(names[first], names[second]) for first, second in wrong]


def find_contradicting(rotations: Mapping[Pair, tuple[np.ndarray, float]], seed: int) -> set[Pair]:
    """The pairs that disagree with the rotations that most of the weight agrees with.

    Args:
        rotations: of each pair of numbers (first, second) of images: (3, 3) second_from_first and its weight, above 0.
        seed: of the drawing of trees.
    """
    if not rotations:
        return set()
    numbers = {image: index for index, image in enumerate(sorted({image for pair in rotations for image in pair}))}
    ends = np.array([[numbers[first], numbers[second]] for first, second in rotations])
    between = np.array([rotation for rotation, _ in rotations.values()])
    weights = np.array([weight for _, weight in rotations.values()], float)
    rng = np.random.default_rng(seed)
    best, best_weight = np.zeros(len(ends)), -1.0
    for tree in range(TREES):
        # A tree that avoids pairs at random, those of little weight first; the first tree takes the heaviest.
        cost = (rng.exponential(size=len(ends)) if tree else np.ones(len(ends))) / weights
        world = _chain(ends, between, cost, len(numbers))
        for _ in range(ROUNDS):
            errors = _measure_errors_deg(world, ends, between)
            world = _average(world, ends, between, np.where(errors <= AGREES_DEG, weights, 0.0))
        errors = _measure_errors_deg(world, ends, between)
        agreeing = float(weights[errors <= AGREES_DEG].sum())
        if agreeing > best_weight:
            best, best_weight = errors, agreeing
    return {pair for pair, error in zip(rotations, best, strict=True) if error > CONTRADICTS_DEG}


def _estimate_rotations(opened: pycolmap.Database, seed: int) -> dict[Pair, tuple[np.ndarray, float]]:
    """Relative rotations of all verified pairs, with the lenses as guessed, weighted by the matches that fit."""
    images = {image.image_id: image for image in opened.read_all_images()}
    cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
    places, found = read_places(opened), {}
    for pair, matches in read_matches(opened):
        if not len(matches):
            continue
        lenses = [cameras[images[image].camera_id] for image in pair]
        points = [places[image][matches[:, side]] for side, image in enumerate(pair)]
        turn, fitting = estimate_turn(lenses, points, seed)
        if fitting:
            found[pair] = (turn, float(fitting))
    return found


def estimate_turn(lenses: Sequence[pycolmap.Camera], points: Sequence[np.ndarray], seed: int) -> tuple[np.ndarray, int]:
    """(3, 3) rotation from one camera's frame to another's by their own matches alone, and how many of these fit; none where it fails.

    Args:
        lenses: of the two cameras.
        points: (M, 2) pixels of the matches in the first image and in the second.
        seed: of RANSAC.
    """
    options = make_verification_options(seed)
    options.compute_relative_pose = True
    numbers = np.repeat(np.arange(len(points[0]), dtype=np.uint32)[:, None], 2, axis=1)
    posed = pycolmap.estimate_calibrated_two_view_geometry(lenses[0], points[0], lenses[1], points[1], numbers, options)
    if posed.cam2_from_cam1 is None:
        return np.eye(3), 0
    return posed.cam2_from_cam1.rotation.matrix(), len(posed.inlier_matches)


def _chain(ends: np.ndarray, between: np.ndarray, cost: np.ndarray, count: int) -> np.ndarray:
    """(N, 3, 3) rotations of all images along the spanning tree of least cost; each part of the graph starts at the identity."""
    graph = coo_matrix((cost, ends.T), shape=(count, count)).tocsr()
    tree = minimum_spanning_tree(graph)
    index = {(int(first), int(second)): number for number, (first, second) in enumerate(ends)}
    world = np.repeat(np.eye(3)[None], count, axis=0)
    seen = np.zeros(count, bool)
    for root in range(count):
        if seen[root]:
            continue
        order, before = breadth_first_order(tree, root, directed=False)
        for image in order[1:]:
            parent = int(before[image])
            number = index.get((parent, int(image)))
            step = between[number] if number is not None else between[index[int(image), parent]].T
            world[image] = step @ world[parent]
        seen[order] = True
    return world


def _average(world: np.ndarray, ends: np.ndarray, between: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Each image's rotation becomes the chordal mean of what its pairs say it is, itself included."""
    total = world * (1e-3 + weights.mean())
    np.add.at(total, ends[:, 1], weights[:, None, None] * (between @ world[ends[:, 0]]))
    np.add.at(total, ends[:, 0], weights[:, None, None] * (between.transpose(0, 2, 1) @ world[ends[:, 1]]))
    left, _, right = np.linalg.svd(total)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    return left @ right


def _measure_errors_deg(world: np.ndarray, ends: np.ndarray, between: np.ndarray) -> np.ndarray:
    difference = between @ world[ends[:, 0]] - world[ends[:, 1]]
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(difference, axis=(1, 2)) / np.sqrt(8), 0, 1)))
