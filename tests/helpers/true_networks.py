"""Networks in place of FoundationPose's that know the truth, up to noise, and how alike two pictures are."""

from collections.abc import Iterator

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from zeroshop_steps.networks.foundationpose.settings import LARGEST_TURN_RAD
from zeroshop_steps.pose.foundationpose.crops import CropPairs
from zeroshop_steps.pose.foundationpose.estimator import FoundationPoseModel

LARGEST_STEP = 0.95  # of LARGEST_TURN_RAD; the hyperbolic tangent never reaches it
CLIPPED_RADII = 0.3  # what hides the object is no farther off than this for the score


class TrueNetworks:
    """Moves each pose to the nearest of the poses that look alike by shape, and ranks poses by what the crops show.

    Args:
        goals: (G, 4, 4) camera_from_model in mm: the true pose, and others that a refiner might be drawn to.
        ready: the model.
        turn_deg: size of the error of each refinement's rotation; its translation is off by as much, seen from the centre.
    """

    def __init__(self, goals: np.ndarray, ready: FoundationPoseModel, turn_deg: float = 2.0) -> None:
        self.batch = 48
        self.goals, self.radius_mm, self.turn_deg = ready.centred(goals), ready.drawn.diameter_mm / 2, turn_deg
        self.rng = np.random.default_rng(0)
        self.refined = 0

    def refine(self, pairs: CropPairs) -> tuple[torch.Tensor, torch.Tensor]:
        """As `PairNetworks` says."""
        self.refined += len(pairs.rendered)
        poses = pairs.camera_from_model.double().numpy()
        traces = np.einsum("gij,nij->ng", self.goals[:, :3, :3], poses[:, :3, :3])
        goals = self.goals[traces.argmax(1)]
        noise = np.radians(self.turn_deg) / np.sqrt(3)
        wanted = Rotation.from_matrix(goals[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1)).as_rotvec()
        wanted = -wanted + noise * self.rng.normal(size=wanted.shape)  # the refiner turns against the axis
        wanted /= np.maximum(np.abs(wanted).max(1, keepdims=True) / (LARGEST_STEP * LARGEST_TURN_RAD), 1.0)
        moved = (goals[:, :3, 3] - poses[:, :3, 3]) / self.radius_mm + noise * self.rng.normal(size=wanted.shape)
        return torch.from_numpy(moved).float(), torch.from_numpy(np.arctanh(wanted / LARGEST_TURN_RAD)).float()

    def score(self, batches: Iterator[CropPairs]) -> torch.Tensor:
        """As `PairNetworks` says: the less the pictures differ where the model is drawn, the higher."""
        return torch.cat([compare(pairs) for pairs in batches])


def compare(pairs: CropPairs) -> torch.Tensor:
    """(N,) minus the mean difference of colours and points where the model is drawn."""
    off = (pairs.rendered - pairs.observed).abs()
    drawn = (pairs.rendered[:, 3:] != 0).any(1)
    off = off[:, :3].mean(1) + off[:, 3:].amax(1).clamp(max=CLIPPED_RADII)
    return -(off * drawn).sum((1, 2)) / drawn.sum((1, 2)).clamp(min=1)
