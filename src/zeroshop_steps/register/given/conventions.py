"""Find how given poses are meant, by which of the usual readings explains the verified matches of image pairs, which know of no poses.

A match supports poses by its Sampson distance to their epipolar geometry, and by lying in front of both cameras. Poses that are right but
noisy support less the stricter one is, so several tolerances are averaged. The turn between two images has the same angle whatever
rigid transform lies between the camera and what carries it (a conjugate rotation): so a hand-eye transform that is missing is told apart
from poses of another recording (Tsai and Lenz 1989, eq. 10).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.transforms import OPENCV_FROM_OPENGL, measure_turn_deg
from zeroshop_steps.register.scene.database import LEAST_TIES, read_matches, read_places
from zeroshop_steps.register.scene.image_set import REFERENCE_PX
from zeroshop_steps.register.verification.epipolar_support import find_explained

TOLERANCES_PX = (4.0, 8.0, 16.0, 32.0)  # per 1000 px of the image's longer side
MOST_MATCHES = 60  # of a pair: more tell nothing new about its poses
LEAST_MATCHES = 200  # in all pairs, to tell anything
MOST_DELAY = 5  # frames
RIGHT, BETTER = 0.3, 0.1
"""Support from which on poses are taken as they are read, and by which another reading must exceed it. Two rings of ten rendered views:
1.00 by true poses, 0.78 with noise of 1 mm and 0.3 degrees, 0.42 with 3 mm and 1 degree, at most 0.10 by wrong axes, inverses or a wrong
order, 0.57 and 0.65 by poses two frames late and one early, since every other camera of a ring looks alike."""
DELAYED = 0.5
"""Support below which a delay is told: an even ring that is late is a turned ring with a few wrong poses, as which it is mended."""
SURE = 0.9  # support from which on other readings are not tried
SAME_ANGLE_DEG, LEAST_ANGLE_DEG = 3.0, 8.0  # turns between images that agree, in the median, and that tell anything
TURNS = 30  # pairs whose turn is estimated, those with most matches

Poses = Mapping[str, np.ndarray]
"""(4, 4) camera_from_world by image name."""


@dataclass(frozen=True)
class PairMatches:
    """Verified matches of two images, as points of their cameras' unit planes.

    Attributes:
        first, second: names of the images.
        rays_first, rays_second: (M, 2).
        pixel: width of a pixel of an image of 1000 px on the unit plane.
    """

    first: str
    second: str
    rays_first: np.ndarray
    rays_second: np.ndarray
    pixel: float


@dataclass(frozen=True)
class Reading:
    """A way in which stated poses may be meant; `claim` says it in words, with what to do. It is told of support `below` some share."""

    claim: str
    read: Callable[[Poses], Poses]
    below: float = 1.0


def list_readings(names: Sequence[str]) -> list[Reading]:
    """The usual faults of poses of images, given in the order in which they were taken."""

    def each(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Poses], Poses]:
        return lambda poses: {name: change(pose) for name, pose in poses.items()}

    flip = OPENCV_FROM_OPENGL
    axes = "they have OpenGL's axes (y up, looking along -z), not OpenCV's: turn y and z of each camera over"
    inverse = "they are world_from_camera (camera to world), not camera_from_world: invert each"
    both = "they are world_from_camera with OpenGL's axes: invert each, and turn y and z of the camera over"
    readings = [
        Reading(axes, each(lambda pose: flip @ pose)),
        Reading(inverse, each(np.linalg.inv)),
        Reading(both, each(lambda pose: flip @ np.linalg.inv(pose))),
    ]
    for delay in sorted(range(-MOST_DELAY, MOST_DELAY + 1), key=abs)[1:]:
        how = f"{abs(delay)} frame{'s' if abs(delay) > 1 else ''} {'late' if delay > 0 else 'early'}"
        claim = f"they are {how}: each image shows what the pose {abs(delay)} {'after' if delay > 0 else 'before'} its own saw"
        readings.append(Reading(f"{claim}; match the clocks of camera and poses", partial(_delay, names=names, by=delay), DELAYED))
    return readings


def _delay(poses: Poses, names: Sequence[str], by: int) -> Poses:
    places = {name: number + by for number, name in enumerate(names)}
    return {name: poses[names[place]] for name, place in places.items() if 0 <= place < len(names) and names[place] in poses}


def read_pairs(database: Path, lenses: Mapping[str, pycolmap.Camera]) -> list[PairMatches]:
    """The verified matches of all pairs that have enough of them, by lenses of the images."""
    pairs = []
    with pycolmap.Database.open(database) as opened:
        images = {image.image_id: image.name for image in opened.read_all_images()}
        places, matched = read_places(opened), read_matches(opened)
    rays = {name: lenses[name].cam_from_img(places[image_id]) for image_id, name in images.items()}
    for pair, matches in matched:
        if len(matches) < LEAST_TIES:
            continue
        matches = matches[:: -(-len(matches) // MOST_MATCHES)]
        one, other = (images[image_id] for image_id in pair)
        pixel = float(np.mean([max(lens.width, lens.height) / lens.mean_focal_length() for lens in (lenses[one], lenses[other])]))
        pairs.append(PairMatches(one, other, rays[one][matches[:, 0]], rays[other][matches[:, 1]], pixel / REFERENCE_PX))
    return pairs


def measure_support(poses: Poses, pairs: Sequence[PairMatches]) -> float:
    """The share of matches that poses explain, averaged over the tolerances; 0 without matches of images that have poses."""
    explained, count = 0.0, 0
    for pair in pairs:
        if pair.first not in poses or pair.second not in poses:
            continue
        second_from_first = (poses[pair.second] @ np.linalg.inv(poses[pair.first]))[:3]
        count += len(pair.rays_first)
        for tolerance_px in TOLERANCES_PX:
            good = find_explained(pair.rays_first, pair.rays_second, second_from_first, tolerance_px * pair.pixel)
            explained += float(good.sum()) / len(TOLERANCES_PX)
    return explained / max(count, 1)


def find_fault(poses: Poses, pairs: Sequence[PairMatches], names: Sequence[str]) -> tuple[float | None, str | None]:
    """How well poses explain the matches, and what is wrong with them, in words.

    Returns:
        The support, None where there are too few matches to tell; and the fault, None where the poses are right.
    """
    known = [pair for pair in pairs if pair.first in poses and pair.second in poses]
    if sum(len(pair.rays_first) for pair in known) < LEAST_MATCHES:
        return None, None
    support = measure_support(poses, known)
    if support >= SURE:
        return support, None
    readings = [reading for reading in list_readings(names) if support < reading.below]
    found = [(measure_support(reading.read(poses), known), reading.claim) for reading in readings]
    best, claim = max(found, key=lambda one: one[0])
    explains = f"the given poses explain {support:.0%} of the images' matches"
    if best >= max(RIGHT, support + BETTER):
        return support, f"{explains}, read otherwise {best:.0%}: {claim}"
    if support >= RIGHT:
        return support, None
    if _turn_alike(poses, known):
        return support, (
            f"{explains}, though they turn by the right angles between images: the transform from the hand or tracker to the camera"
            " (hand-eye calibration) is missing or wrong: multiply it to each pose"
        )
    return support, f"{explains}, and no usual misreading of them does better: they belong to another recording, or their order is lost"


def _turn_alike(poses: Poses, pairs: Sequence[PairMatches]) -> bool:
    """Whether the angles by which poses turn between images agree with those of the matches' essential matrices."""
    differences = []
    for pair in sorted(pairs, key=lambda one: -len(one.rays_first))[:TURNS]:
        essential, inliers = cv2.findEssentialMat(pair.rays_first, pair.rays_second, np.eye(3), cv2.RANSAC, 0.999, 2 * pair.pixel)
        if essential is None or essential.shape != (3, 3):
            continue
        seen = cv2.recoverPose(essential, pair.rays_first, pair.rays_second, np.eye(3), mask=inliers)[1]
        given = (poses[pair.second] @ np.linalg.inv(poses[pair.first]))[:3, :3]
        angles = [measure_turn_deg(np.eye(3), turn) for turn in (seen, given)]
        if max(angles) > LEAST_ANGLE_DEG:
            differences.append(abs(angles[0] - angles[1]))
    return len(differences) >= TURNS // 6 and float(np.median(differences)) < SAME_ANGLE_DEG
