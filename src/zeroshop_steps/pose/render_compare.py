"""Estimate poses without any network: rotations from all sides by shape, then renderings compared with the image.

For every detection with a mask, hypotheses from 42 directions with 24 in-plane rotations each are aligned with the measured points
by ICP. The best are compared with depth, silhouette and colour, improved by small turns, and the winner is refined. Writes BOP's
result CSV. The score of an estimate is the probability that no point of the model is off by more than a tenth of its diameter
(confidence.py).
"""

import argparse
import functools
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.detections import Detection
from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.bop.scoring.pose_error import ModelPoints, mssd
from zeroshop_steps.pose import dataset
from zeroshop_steps.pose.confidence import SAME_DIAMETERS, SURE_CONFIDENCE, estimate_confidence
from zeroshop_steps.pose.dataset import NEAR_DIAMETERS
from zeroshop_steps.pose.hypotheses import PoseSearch
from zeroshop_steps.pose.pose_score import AGREE_MM, COARSE_RAYS, FINE_RAYS, RAYS, ImagePatch, PoseScorer, cut_patch

# Chosen on six virtual tables of the demo objects, the test set with seed 1 (docs/results.md, "Detection and poses").
LEAST_POINTS = 30  # measured points of a detection; fewer do not fix a pose
NUDGED = 8  # best hypotheses that are improved by small turns
NUDGES_DEG = (8.0, 4.0, 2.0, 1.0)  # sizes of these turns, one after the other; starts are 15 degrees apart
SPARE_DETECTIONS = 3  # of a target, beyond its number of instances: two of other places, and one of a part or of the whole
EXTENDED = 1.1  # times as large as a detection: with less, what it lacks does not matter


@dataclass(frozen=True)
class PoseEstimate:
    """One estimated pose.

    Attributes:
        camera_from_model: (4, 4) mm.
        explained: 0..1, how well it explains the image (`PoseScorer.score`).
        margin: 0..1, how much better that is than with the best pose that clearly differs.
        points: number of measured points in the mask.
    """

    camera_from_model: np.ndarray
    explained: float
    margin: float
    points: int


METHOD = {"rank": 0, "mem_mb": 3000, "runtime_min": 120, "threads": 2}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    dataset.add_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Estimate the poses of all detections in the target images."""
    dataset.run_estimator(args, functools.partial(prepare, args), SPARE_DETECTIONS, SURE_CONFIDENCE)


def prepare(args: argparse.Namespace, models: dict[int, ObjectModel]) -> dataset.Estimator:
    """The estimator of the poses of these models; it has no options."""
    ready = {number: PreparedModel(model) for number, model in models.items()}

    def estimator(
        detection: Detection, mask: np.ndarray, photo: np.ndarray, depth_mm: np.ndarray, frame: Frame
    ) -> tuple[np.ndarray, float] | None:
        found = estimate_pose(mask, photo, depth_mm, frame.intrinsics, ready[detection.object_id])
        if found is None:
            return None
        return found.camera_from_model, estimate_confidence(found.explained, found.margin, found.points)

    return estimator


class PreparedModel:
    """One model with its search and its scorer."""

    def __init__(self, model: ObjectModel) -> None:
        self.model = model
        self.search = PoseSearch(model.mesh, model.diameter_mm)
        self.comparison = PoseScorer(model.mesh)
        self.points = ModelPoints.from_vertices(model.mesh.vertices)
        self.renderer = DepthRenderer(model.mesh)


def estimate_pose(
    mask: np.ndarray, photo: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, ready: PreparedModel
) -> PoseEstimate | None:
    """The pose of one detection; None if too little of it was measured.

    Args:
        mask: (height, width) bool.
        photo: (height, width, 3) uint8.
        depth_mm: (height, width) measured, 0 where there is none.
        intrinsics: (3, 3) BOP's K.
        ready: the model.
    """
    points = collect_points(mask, depth_mm, intrinsics, ready.model.diameter_mm)
    if len(points) < LEAST_POINTS:
        return None
    poses = ready.search.search(points, depth_mm, mask, intrinsics)
    coarse = cut_patch(photo, depth_mm, mask, intrinsics, COARSE_RAYS)
    poses = poses[np.argsort(-ready.comparison.score(poses, coarse), kind="stable")[:NUDGED]]
    poses, _ = nudge_poses(poses, cut_patch(photo, depth_mm, mask, intrinsics, RAYS), ready.comparison, ready.model, ready.search.is_open)
    poses = np.concatenate([poses, ready.search.refine(poses, points)])
    scores = ready.comparison.score(poses, cut_patch(photo, depth_mm, mask, intrinsics, FINE_RAYS))
    # Rounded, so that the last bits do not decide between equal poses.
    best = int(np.argmax(np.round(scores, 9)))
    apart_mm = mssd(poses, np.repeat(poses[best][None], len(poses), 0), ready.points, ready.model.symmetries)
    others = scores[apart_mm > SAME_DIAMETERS * ready.model.diameter_mm]
    estimate = PoseEstimate(poses[best], float(scores[best]), float(scores[best] - max(others, default=0.0)), len(points))
    whole = extend_mask(mask, depth_mm, intrinsics, estimate.camera_from_model, ready.renderer)
    if whole.sum() < EXTENDED * mask.sum():
        return estimate
    return replace(estimate, camera_from_model=improve_pose(estimate.camera_from_model, whole, photo, depth_mm, intrinsics, ready))


def extend_mask(mask: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray, renderer: DepthRenderer) -> np.ndarray:
    """(height, width) bool: the detection and all pixels whose depth is that of the model at its pose: what of it the detection lacks."""
    height, width = mask.shape
    drawn_mm = renderer.render(pose, intrinsics, width, height).image(width, height)
    return mask | ((drawn_mm > 0) & (depth_mm > 0) & (np.abs(drawn_mm - depth_mm) < AGREE_MM))


def improve_pose(
    pose: np.ndarray, mask: np.ndarray, photo: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, ready: PreparedModel
) -> np.ndarray:
    """(4, 4) the pose after more steps of ICP or small turns, whichever explains the mask better."""
    points = collect_points(mask, depth_mm, intrinsics, ready.model.diameter_mm)
    poses = np.concatenate([pose[None], ready.search.refine(pose[None], points)])
    poses, _ = nudge_poses(poses, cut_patch(photo, depth_mm, mask, intrinsics, RAYS), ready.comparison, ready.model, ready.search.is_open)
    return poses[int(np.argmax(ready.comparison.score(poses, cut_patch(photo, depth_mm, mask, intrinsics, FINE_RAYS))))]


def collect_points(mask: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, diameter_mm: float) -> np.ndarray:
    """(N, 3) measured points of a mask in random order, without those too far away to be on the object; camera frame, mm."""
    rows, columns = np.nonzero(mask & (depth_mm > 0))
    depths = depth_mm[rows, columns].astype(float)
    near = np.abs(depths - np.median(depths)) < NEAR_DIAMETERS * diameter_mm if len(depths) else np.zeros(0, bool)
    pixels = np.stack([columns, rows, np.ones_like(rows)], 1)[near]
    points = pixels @ np.linalg.inv(intrinsics).T * depths[near][:, None]
    return points[np.random.default_rng(0).permutation(len(points))]


def nudge_poses(
    poses: np.ndarray, patch: ImagePatch, comparison: PoseScorer, model: ObjectModel, moved: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Turn poses about the model's centre in ever smaller steps as long as their score improves.

    Args:
        poses: (P, 4, 4) camera_from_model, mm.
        patch: of the image.
        comparison: scores the poses.
        model: whose poses they are.
        moved: whether to move them as well, by as much as the turns move the surface. A model that may be hollow lacks its inner wall,
            and measured points on that wall have drawn the pose towards the outer one.

    Returns:
        The poses and their (P,) scores.
    """
    middle = (model.mesh.vertices.min(0) + model.mesh.vertices.max(0)) / 2
    poses, scores = poses.copy(), comparison.score(poses, patch)
    for angle in NUDGES_DEG:
        turns = np.tile(np.eye(4), (12 if moved else 6, 1, 1))
        turns[:6, :3, :3] = Rotation.from_rotvec(np.radians(angle) * np.concatenate([np.eye(3), -np.eye(3)])).as_matrix()
        turns[:6, :3, 3] = middle - turns[:6, :3, :3] @ middle
        turns[6:, :3, 3] = np.radians(angle) * model.diameter_mm / 2 * np.concatenate([np.eye(3), -np.eye(3)])[: len(turns) - 6]
        # At most so many rounds of each size.
        for _ in range(2):
            others = poses[:, None] @ turns
            gained = comparison.score(others.reshape(-1, 4, 4), patch).reshape(len(poses), len(turns))
            best = gained.argmax(1)
            better = gained[np.arange(len(poses)), best] > scores
            poses[better], scores[better] = others[better, best[better]], gained[better, best[better]]
            if not better.any():
                break
    return poses, scores
