"""Leave out pairs of images whose relative rotation contradicts those of the other pairs.

Sides of an object that look alike give pairs that pass every check of two views, with many sure matches. Around the object they do not
close: rotations chained along other pairs lead elsewhere. COLMAP's robust rotation averaging (Chatterjee and Govindu, Efficient and Robust
Large-Scale Rotation Averaging, ICCV 2013) finds rotations of all images that most of the matches agree with. Pairs that disagree with them
are left out. On 50 made rings of cameras with 200 false pairs, it found 139 and lost 64 right ones; spanning trees drawn at random found
146 and lost 63, in a hundred times as long.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.transforms import measure_turn_deg
from zeroshop_steps.register.matching.verified_matches import make_verification_options
from zeroshop_steps.register.scene.database import delete_pair, read_matches, read_places

CONTRADICTS_DEG = 70.0
"""Of a pair's rotation from that of its images. Sides that look alike are 90 or 180 degrees apart; right matches of flat sides, whose
rotation is ambiguous, are off by less, and a focal length that is guessed 15 % too short bends rotations of 100 degrees by 12."""

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
    """The pairs that disagree with the rotations that most of the weight agrees with, in each group of images that pairs tie together.

    Args:
        rotations: of each pair of numbers (first, second) of images: (3, 3) second_from_first and its weight, a number of matches.
        seed: of COLMAP's solver.
    """
    wrong, left = set(), dict(rotations)
    while left and (world := _average_rotations(left, seed)):
        done = {pair for pair in left if world.keys() >= set(pair)}
        wrong |= {pair for pair in done if measure_turn_deg(left[pair][0] @ world[pair[0]], world[pair[1]]) > CONTRADICTS_DEG}
        left = {pair: found for pair, found in left.items() if pair not in done}
    return wrong


def _average_rotations(rotations: Mapping[Pair, tuple[np.ndarray, float]], seed: int) -> dict[int, np.ndarray]:
    """{number of an image: (3, 3) camera from world} of the largest group of images that pairs tie together."""
    model, graph = pycolmap.Reconstruction(), pycolmap.PoseGraph()
    model.add_camera_with_trivial_rig(pycolmap.Camera(model="SIMPLE_PINHOLE", camera_id=1, width=1, height=1, params=[1.0, 0.5, 0.5]))
    for image in sorted({image for pair in rotations for image in pair}):
        model.add_image_with_trivial_frame(pycolmap.Image(name=str(image), camera_id=1, image_id=1 + image))
    for (first, second), (rotation, weight) in rotations.items():
        edge = pycolmap.PoseGraphEdge()
        edge.cam2_from_cam1 = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), np.zeros(3))
        edge.num_matches = round(np.sqrt(weight))  # many matches hold a rotation more surely, but one false pair must not outweigh others
        graph.add_edge(1 + first, 1 + second, edge)
    options = pycolmap.RotationEstimatorOptions()
    options.random_seed, options.reweighting = seed, pycolmap.RotationAveragingReweighting.INLIER_MATCH_COUNT
    if not pycolmap.run_rotation_averaging(options, graph, model, []):
        return {}
    placed = [image for image in model.images.values() if image.has_pose]
    return {image.image_id - 1: image.cam_from_world().rotation.matrix() for image in placed}


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
