"""Refuse a model whose circle is open although its matches close it: sides that look alike were laid onto each other.

A carton whose front and back are equal looks the same after half a turn. Where its photos are folded onto half a circle, all of them fit,
and so do their masks. But photos on either side of the place where the circle was cut still match: by these matches alone, the camera went
on by a few degrees, into the gap where the model has none. In a right model of such a carton, photos of its two sides match, too, but what
they say lies where other photos are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import take_cameras
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.transforms import measure_turn_deg
from zeroshop_steps.geometry.support.ground_plane import estimate_up_from_roll
from zeroshop_steps.register.matching.rotation_consistency import estimate_turn
from zeroshop_steps.register.scene.database import LEAST_TIES
from zeroshop_steps.register.scene.record import Evidence, Finding
from zeroshop_steps.register.verification.epipolar_support import count_epipolar_support
from zeroshop_steps.register.verification.view_coverage import measure_directions, measure_view_coverage
from zeroshop_steps.runtime.errors import StepError

Pair = tuple[str, str]

GAP_DEG = 90.0
"""Azimuths without a camera: what is folded has a gap of about half a circle, or more."""
CONTRADICTED_SHARE = 0.7  # of the matches of a pair that the model contradicts
NEAR_DEG, APART_DEG = 75.0, 40.0
"""By its own matches, such a pair is as near as this; in the model, it is so much farther apart."""
BEYOND_DEG, LEVEL_DEG = 10.0, 20.0
"""Where a pair says that one of its cameras is, seen from the other, none is within this azimuth; both are at most so far above or below
all cameras. Where two equal bags stood beside a figure, pairs matched one to the other, and said that a camera was 25 degrees higher than
all, or below the table."""
LEAST_PAIRS, LEAST_SHARE = 3, 0.6
"""So many pairs are beyond, and this share of those that are looked at: 7 of 8, 7 of 8 and 10 of 11 of folded cartons, at most 1 of 3 of 12
halves of captures that are right."""


@dataclass(frozen=True)
class LoopGap:
    """Pairs of images that match well, and that a model lays far apart.

    Attributes:
        gap_deg: the largest range of azimuths around the object that has no camera; below `GAP_DEG`, no pairs are looked at.
        judged: how many pairs there are.
        beyond: names of those whose own relative rotation puts one of both where no camera is.
    """

    gap_deg: float
    judged: int
    beyond: tuple[Pair, ...]

    @property
    def strength(self) -> float:
        """Of the finding that the gap is no gap."""
        return len(self.beyond) / max(LEAST_PAIRS, LEAST_SHARE * self.judged)

    def figures(self) -> dict[str, Any]:
        """As written to registration.json."""
        beyond = [list(pair) for pair in self.beyond]
        return {"gap_deg": round(self.gap_deg, 1), "judged": self.judged, "beyond": beyond}


def check_loop_gap(model: pycolmap.Reconstruction, pinhole_model: pycolmap.Reconstruction, database: Path, seed: int) -> Evidence:
    """Whether a model is folded; arguments as of `measure_loop_gap`. Without a gap, there is nothing to say."""
    found = measure_loop_gap(model, pinhole_model, database, seed)
    if found.gap_deg < GAP_DEG:
        return Evidence()
    findings: tuple[Finding, ...] = ()
    if found.beyond:
        said = (
            f"no camera is within {found.gap_deg:.0f} degrees around the object, but {len(found.beyond)} pairs of images, such as"
            f" {' and '.join(found.beyond[0])}, match as if there were some"
        )
        findings = (Finding("loop_gap", found.strength, said),)
    return Evidence({"gap_evidence": found.figures()}, findings)


def measure_loop_gap(model: pycolmap.Reconstruction, pinhole_model: pycolmap.Reconstruction, database: Path, seed: int) -> LoopGap:
    """What the matches say about the widest gap between a model's cameras.

    Args:
        model: as the features were seen, with distortion.
        pinhole_model: the same without distortion.
        database: the verified matches of all pairs, also of those that had no part in the model.
        seed: of the RANSAC loops.
    """
    cameras = list(take_cameras(pinhole_model))
    try:
        gap_deg = measure_view_coverage(cameras).largest_gap_deg
    except StepError:  # the cameras look away from each other
        gap_deg = 0.0
    if gap_deg < GAP_DEG:
        return LoopGap(gap_deg, 0, ())
    evidence = count_epipolar_support(model, database)
    total = evidence.supporting + evidence.contradicting
    doubtful = (total >= LEAST_TIES) & (evidence.contradicting >= CONTRADICTED_SHARE * total)
    pairs = [(evidence.names[one], evidence.names[other]) for one, other in np.argwhere(np.triu(doubtful))]
    turns = {pair: turn for pair, turn in zip(pairs, estimate_turns(model, database, pairs, seed), strict=True) if turn is not None}
    rotations = {image.name: image.cam_from_world().rotation.matrix() for image in model.images.values() if image.has_pose}
    up, _ = estimate_up_from_roll([View(camera, Path(camera.name), None) for camera in cameras])
    return LoopGap(gap_deg, *find_pairs_across_gap(rotations, up, turns))


def find_pairs_across_gap(
    rotations: Mapping[str, np.ndarray], up: np.ndarray, turns: Mapping[Pair, np.ndarray]
) -> tuple[int, tuple[Pair, ...]]:
    """How many pairs of images are laid much farther apart than they say, and those of them that say that a camera is where none is.

    Args:
        rotations: {image name: (3, 3) from the world to the camera}.
        up: (3,) in the world.
        turns: {names of two images: (3, 3) from the first camera to the second, by their matches}.
    """
    azimuths, elevations = measure_directions(np.array([-rotation[2] for rotation in rotations.values()]), up)
    judged, beyond = 0, list[Pair]()
    for (one, other), turn in turns.items():
        own_deg = measure_turn_deg(np.eye(3), turn)
        if own_deg > NEAR_DEG or measure_turn_deg(rotations[one], rotations[other]) < own_deg + APART_DEG:
            continue
        judged += 1
        places = np.array([-(turn @ rotations[one])[2], -(turn.T @ rotations[other])[2]])
        turned_deg, raised_deg = measure_directions(places, up)
        away = np.abs((turned_deg[:, None] - azimuths + 180.0) % 360.0 - 180.0).min(1)
        level = (raised_deg > elevations.min() - LEVEL_DEG) & (raised_deg < elevations.max() + LEVEL_DEG)
        if level.all() and (away > BEYOND_DEG).any():
            beyond.append((one, other))
    return judged, tuple(beyond)


def estimate_turns(model: pycolmap.Reconstruction, database: Path, pairs: Sequence[Pair], seed: int) -> list[np.ndarray | None]:
    """(3, 3) rotations from the first camera's frame to the second's, by the verified matches of each pair alone; None where these fail."""
    by_name = {image.name: image for image in model.images.values() if image.has_pose}
    turns: list[np.ndarray | None] = []
    with pycolmap.Database.open(database) as opened:
        for names in pairs:
            images = [by_name[name] for name in names]
            matches = opened.read_two_view_geometry(*(image.image_id for image in images)).inlier_matches
            lenses = [model.cameras[image.camera_id] for image in images]
            points = [opened.read_keypoints(image.image_id)[matches[:, side], :2].astype(np.float64) for side, image in enumerate(images)]
            turn, fitting = estimate_turn(lenses, points, seed)
            turns.append(turn if fitting >= LEAST_TIES else None)
    return turns
