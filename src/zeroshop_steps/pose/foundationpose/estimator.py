"""The pose of one object in one photo with depth: hypotheses, refined and ranked; and its pose in the next frame of a film."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from zeroshop_steps.bop.formats.models import ObjectModel, measure_diameter_mm
from zeroshop_steps.pose.foundationpose.crops import FOR_REFINER, FOR_SCORER, CropPairs, CropStyle, DrawnModel, Observation, cut_pairs
from zeroshop_steps.pose.foundationpose.depth_filter import filter_depth
from zeroshop_steps.pose.foundationpose.networks import PairNetworks
from zeroshop_steps.pose.foundationpose.poses import apply_update
from zeroshop_steps.pose.foundationpose.start_poses import estimate_centre, make_rotations

LEAST_POINTS = 4  # measured points in a mask; with fewer, no pose is estimated


class FoundationPoseModel:
    """One model, ready to be looked for.

    Attributes:
        drawn: for rendering; its origin is the centre of the model's box.
        centre: (3,) mm, that centre in the model's frame.
        rotations: (N, 3, 3) camera_from_model of the hypotheses.
    """

    def __init__(self, model: ObjectModel, device: torch.device) -> None:
        vertices = model.mesh.vertices
        self.centre = (vertices.min(0) + vertices.max(0)) / 2
        self.drawn = DrawnModel.of(model.mesh, self.centre, measure_diameter_mm(vertices), device)
        self.rotations = make_rotations(model.symmetries)

    def centred(self, camera_from_model: np.ndarray) -> np.ndarray:
        """(N, 4, 4) poses of the model whose origin is its centre, from those of the model as its file has it."""
        moved = camera_from_model.copy()
        moved[:, :3, 3] += moved[:, :3, :3] @ self.centre
        return moved

    def as_in_file(self, camera_from_centred: np.ndarray) -> np.ndarray:
        """The inverse of `centred`."""
        moved = camera_from_centred.copy()
        moved[:, :3, 3] -= moved[:, :3, :3] @ self.centre
        return moved


@dataclass(frozen=True)
class PoseEstimator:
    """Estimates poses.

    Attributes:
        networks: the refiner and the scorer.
        device: where all is computed.
        iterations: refinements of each hypothesis.
        depth_cut_mm: depth from which on nothing counts as measured.
    """

    networks: PairNetworks
    device: torch.device
    iterations: int = 5
    depth_cut_mm: float = 1500.0

    def observe(self, photo: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray) -> tuple[Observation, np.ndarray]:
        """A (H, W, 3) uint8 photo with its (H, W) depth on the device, and the filtered depth."""
        filtered = filter_depth(depth_mm, self.depth_cut_mm)
        return Observation.of(photo, filtered, intrinsics, self.device), filtered

    def register(
        self, mask: np.ndarray, photo: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, ready: FoundationPoseModel
    ) -> np.ndarray | None:
        """(4, 4) camera_from_model in mm of the object in a mask; None where too little of it was measured.

        Args:
            mask: (H, W) bool.
            photo: (H, W, 3) uint8.
            depth_mm: (H, W) measured, 0 where there is none.
            intrinsics: (3, 3) BOP's K.
            ready: the model.
        """
        seen, filtered = self.observe(photo, depth_mm, intrinsics)
        centre = estimate_centre(mask, filtered, intrinsics)
        if centre is None or np.count_nonzero(mask & (filtered > 0)) < LEAST_POINTS:
            return None
        starts = np.tile(np.eye(4), (len(ready.rotations), 1, 1))
        starts[:, :3, :3], starts[:, :3, 3] = ready.rotations, centre
        poses = self._refine(seen, ready.drawn, torch.as_tensor(starts, dtype=torch.float32, device=self.device), self.iterations)
        best = int(self._score(seen, ready.drawn, poses).argmax())
        return self._pose_of(poses[best : best + 1], ready)

    def track(
        self, camera_from_model: np.ndarray, photo: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, ready: FoundationPoseModel
    ) -> np.ndarray:
        """The (4, 4) pose in this frame of a film, refined once from that in the frame before; arguments are those of `register`."""
        seen, _ = self.observe(photo, depth_mm, intrinsics)
        start = torch.as_tensor(ready.centred(camera_from_model[None]), dtype=torch.float32, device=self.device)
        return self._pose_of(self._refine(seen, ready.drawn, start, 1), ready)

    def _refine(self, seen: Observation, model: DrawnModel, poses: Tensor, iterations: int) -> Tensor:
        for _ in range(iterations):
            poses = torch.cat(
                [
                    apply_update(pairs.camera_from_model, *self.networks.refine(pairs), model.diameter_mm)
                    for pairs in self._pairs(seen, model, poses, FOR_REFINER)
                ]
            )
        return poses

    def _score(self, seen: Observation, model: DrawnModel, poses: Tensor) -> Tensor:
        return self.networks.score(self._pairs(seen, model, poses, FOR_SCORER))

    def _pairs(self, seen: Observation, model: DrawnModel, poses: Tensor, style: CropStyle) -> Iterator[CropPairs]:
        return (cut_pairs(seen, model, part, style) for part in poses.split(self.networks.batch))

    def _pose_of(self, poses: Tensor, ready: FoundationPoseModel) -> np.ndarray:
        """(4, 4) the first of these poses, in double precision and with an exact rotation."""
        pose = poses[:1].double().cpu().numpy()
        left, _, right = np.linalg.svd(pose[:, :3, :3])
        pose[:, :3, :3] = left @ right
        return np.asarray(ready.as_in_file(pose)[0])
