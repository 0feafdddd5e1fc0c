"""The pose of one object in one photo with depth: hypotheses, refined and ranked; and its pose in the next frame of a film."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn import functional as F

from zeroshop_steps.bop.formats.models import ObjectModel, measure_diameter_mm
from zeroshop_steps.networks.foundationpose.settings import LARGEST_TURN_RAD
from zeroshop_steps.pose.foundationpose.crops import FOR_REFINER, FOR_SCORER, CropPairs, CropStyle, DrawnModel, Observation, cut_pairs
from zeroshop_steps.pose.foundationpose.networks import PairNetworks

LEAST_VIEWS = 40  # directions at least: the corners of a sphere of triangles; an icosahedron divided once has 42
SAME_TURN_DEG = 30.0  # rotations that differ by less, up to a symmetry of the object, are the same
RADIUS_PX = 2  # of the windows, squares of 5 x 5 pixels
STEP_MM = 1.0  # a neighbour that differs by more speaks against a pixel
MOST_AGAINST = 0.8  # share of the neighbours that may do so
LAYER_MM = 10.0  # only values this close to the mean of the window are averaged
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


def apply_update(camera_from_model: Tensor, translation: Tensor, turn: Tensor, diameter_mm: float) -> Tensor:
    """Poses moved as the refiner says: (N, 4, 4) camera_from_model in mm, of a model whose origin is its centre.

    Translation and rotation are apart: the model turns about its own centre (section 3.3 of the paper).

    Args:
        camera_from_model: (N, 4, 4).
        translation: (N, 3) in radii of the model.
        turn: (N, 3) axis times angle before the hyperbolic tangent. The published refiner turns against the axis: it was trained
            with the transposed rotation.
        diameter_mm: of the model.
    """
    x, y, z = (LARGEST_TURN_RAD * torch.tanh(turn)).unbind(1)
    zero = torch.zeros_like(x)
    against = torch.stack([zero, z, -y, -z, zero, x, y, -x, zero], dim=1).view(-1, 3, 3)
    moved = camera_from_model.clone()
    with torch.autocast(moved.device.type, enabled=False):  # the networks may run in half precision, poses may not
        moved[:, :3, :3] = torch.linalg.matrix_exp(against) @ camera_from_model[:, :3, :3]
    moved[:, :3, 3] += translation * (diameter_mm / 2)
    return moved


def filter_depth(depth_mm: np.ndarray, cut_mm: float) -> np.ndarray:
    """(H, W) depth that is 0 from `cut_mm` on and where too few neighbours agree, else the mean of the neighbourhood."""
    depth = torch.from_numpy(np.where(depth_mm < cut_mm, depth_mm, 0.0).astype(np.float32))
    return _smooth(_drop_lonely(depth)).numpy()


def _windows(depth: Tensor) -> tuple[Tensor, Tensor]:
    """(25, H, W) the values around each pixel, and whether they lie in the image."""
    padded = torch.stack([depth, torch.ones_like(depth)])[:, None]
    values, inside = F.unfold(padded, 2 * RADIUS_PX + 1, padding=RADIUS_PX).unflatten(2, depth.shape)
    return values, inside > 0


def _drop_lonely(depth: Tensor) -> Tensor:
    values, inside = _windows(depth)
    against = inside & ((values <= 0) | ((values - depth).abs() > STEP_MM))
    return torch.where(against.sum(0) > MOST_AGAINST * inside.sum(0), 0.0, depth)


def _smooth(depth: Tensor) -> Tensor:
    values, _ = _windows(depth)
    there = values > 0
    mean = (values * there).sum(0) / there.sum(0).clamp(min=1)
    away = torch.arange(-RADIUS_PX, RADIUS_PX + 1)
    weights = torch.exp(-(away[:, None] ** 2 + away[None] ** 2) / (2 * 2.0**2)).flatten()[:, None, None]
    weights = weights * (there & ((values - mean).abs() < LAYER_MM))
    return (weights * values).sum(0) / weights.sum(0).clamp(min=1e-12)


def make_rotations(symmetries: np.ndarray) -> np.ndarray:
    """(N, 3, 3) camera_from_model rotations from all sides, without those that a symmetry makes alike.

    Args:
        symmetries: (S, 4, 4) model_from_model, the identity among them.
    """
    turns = Rotation.from_euler("z", -np.arange(0.0, 360.0, 60.0)[:, None], degrees=True).as_matrix()
    all_of_them = (turns[None] @ _make_views()[:, None]).reshape(-1, 3, 3)
    return all_of_them[_find_different(all_of_them, symmetries[:, :3, :3])]


def _make_views() -> np.ndarray:
    """(V, 3, 3) camera_from_model of cameras all around that look at the model, upright where that is defined."""
    divisions = 1
    while len(corners := np.asarray(trimesh.creation.icosphere(divisions, 1.0).vertices)) < LEAST_VIEWS:
        divisions += 1
    forward = -corners / np.linalg.norm(corners, axis=1, keepdims=True)
    right = np.cross([0.0, 0.0, 1.0], forward)
    right[~right.any(1)] = [1.0, 0.0, 0.0]
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def _find_different(rotations: np.ndarray, symmetries: np.ndarray) -> list[int]:
    """Indices of the rotations, the first first, without those that differ by less than SAME_TURN_DEG from an earlier one."""
    least_trace = 1.0 + 2.0 * np.cos(np.radians(SAME_TURN_DEG))
    kept: list[int] = []
    for index, rotation in enumerate(rotations):
        alike = rotation @ symmetries  # (S, 3, 3)
        traces = np.einsum("kij,sij->ks", rotations[kept], alike) if kept else np.zeros((0, 1))
        if not (traces > least_trace).any():
            kept.append(index)
    return kept


def estimate_centre(mask: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray) -> np.ndarray | None:
    """(3,) mm, where the object's centre may be: in the middle of the mask's box, at its median depth. None where it has no depth.

    Args:
        mask: (H, W) bool.
        depth_mm: (H, W) measured, 0 where there is none.
        intrinsics: (3, 3) BOP's K.
    """
    measured = depth_mm[mask & (depth_mm > 0)]
    if not len(measured):
        return None
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    middle = [(columns[0] + columns[-1]) / 2, (rows[0] + rows[-1]) / 2, 1.0]
    return np.linalg.inv(intrinsics) @ middle * float(np.median(measured))
