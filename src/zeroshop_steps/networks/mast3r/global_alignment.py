"""Several pictures in one metric frame: what the network says of all pairs, brought to agree in a coarse and a fine stage.

Duisterhof et al., MASt3R-SfM, 3DV 2025, sections 4.2 to 4.4: canonical point maps (equation 3), coarse alignment of matched points in
space (equation 4), refinement by reprojection (equation 5). The focal length is that of DUSt3R (Wang et al. 2024, section 3.3).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import torch
from torch import Tensor

from zeroshop_steps.geometry.cameras.pinhole import fit_similarity
from zeroshop_steps.networks.mast3r.inference import PairPredictor
from zeroshop_steps.networks.mast3r.matching import Matches, match_pair
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import ProgressReport

COARSE_STEPS, COARSE_RATE = 300, 0.07  # of Adam, and its rate at the start
FINE_STEPS, FINE_RATE = 500, 0.01
ERROR_PX = 1.0
"""From where on an error of the fine stage counts less than its square."""
CELL_PX = 16  # the depths of a picture are bent by one factor for each square of this size
DEPTH_DEVIATION = 0.02
"""How far, as a share, the fine stage may bend the depths of a picture at little cost."""
BENDING_WEIGHT = 1e-2  # of that cost, beside the errors in the pictures
LEAST_MATCHES = 30  # of a pair; pairs with fewer are left out
TYPICAL_SHARE = 0.99
"""Of the median confidence: pixels above it count for the size of a picture. Less than 1, so that some are left where all are alike."""
EVERY = 7  # of the surer half of the pixels, only each so many-th takes part in the first similarity, to save time
LEAST_ERROR_PX = 0.1  # smaller errors weigh no more, so that no pixel decides alone
COARSE_MATCHES, FINE_MATCHES = 4000, 8000
"""The most matches that take part in a stage; of more, evenly spread ones are taken."""


@dataclass(frozen=True)
class CanonicalView:
    """A picture's own points, averaged over its pairs.

    Attributes:
        depth_m: (height, width) along the optical axis.
        confidence: (height, width).
        focal_px: of the network's picture; its middle is the principal point.
        scale_deviation: standard deviation of the sizes that its pairs say, as a share.
    """

    depth_m: np.ndarray
    confidence: np.ndarray
    focal_px: float
    scale_deviation: float


@dataclass(frozen=True)
class Alignment:
    """Pictures in one frame, that of the first camera, in metres.

    Attributes:
        world_from_camera: (N, 4, 4) rigid.
        focal_px: (N,) of the network's pictures.
        depth_m: (height, width) of each picture, along its optical axis.
        confidence: (height, width) of each picture.
        error_px: median reprojection error of the matches.
        scale_deviation: standard deviation of the size of all, as a share, as far as the pairs disagree on it.
    """

    world_from_camera: np.ndarray
    focal_px: np.ndarray
    depth_m: list[np.ndarray]
    confidence: list[np.ndarray]
    error_px: float
    scale_deviation: float


def align_images(predictor: PairPredictor, min_confidence: float) -> Alignment:
    """Align all pictures of a predictor.

    Args:
        predictor: the network with two pictures or more.
        min_confidence: of the features of a match.

    Raises:
        StepError: a picture matches no other.
    """
    count = len(predictor.framings)
    canonical, relative, matches = _predict_all_pairs(predictor, count, min_confidence)
    start = _chain_pairs(relative, matches, count)
    return _optimize(canonical, matches, start)


def _predict_all_pairs(
    predictor: PairPredictor, count: int, min_confidence: float
) -> tuple[list[CanonicalView], dict[tuple[int, int], np.ndarray], dict[tuple[int, int], Matches]]:
    """Canonical points of all pictures, similarities first_from_second, and matches, of all ordered pairs."""
    points: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in range(count)]
    other, matches = {}, {}
    pairs = list(permutations(range(count), 2))
    with ProgressReport("looking at pairs", len(pairs)) as report:
        for first, second in pairs:
            sides = predictor.pair(first, second)
            maps = [(side.points[0].double().cpu().numpy(), side.confidence[0].double().cpu().numpy()) for side in sides]
            points[first].append(maps[0])
            other[first, second] = maps[1]
            found = match_pair(*sides, min_confidence)
            if len(found.confidence) >= LEAST_MATCHES:
                matches[first, second] = found
            report.advance()
    canonical, mean_points = [], []
    for maps in points:
        weight = np.sum([confidence for _, confidence in maps], axis=0)
        mean = np.sum([place * confidence[..., None] for place, confidence in maps], axis=0) / weight[..., None]
        sizes = [np.log(np.median(place[..., 2][confidence > np.median(confidence) * TYPICAL_SHARE])) for place, confidence in maps]
        canonical.append(CanonicalView(mean[..., 2], weight / len(maps), estimate_focal_px(mean, weight), float(np.std(sizes))))
        mean_points.append(mean)
    relative = {}
    for (first, second), (place, confidence) in other.items():
        sure = confidence >= np.quantile(confidence, 0.5)
        relative[first, second] = fit_similarity(mean_points[second][sure][::EVERY], place[sure][::EVERY])
    return canonical, relative, matches


def estimate_focal_px(points: np.ndarray, confidence: np.ndarray, rounds: int = 20) -> float:
    """The focal length in pixels that best explains (height, width, 3) points about the middle of the picture, robustly (Weiszfeld)."""
    height, width = confidence.shape
    columns, rows = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    valid = points[..., 2] > 1e-6
    pixels = np.stack([columns, rows], axis=-1)[valid]
    directions = points[..., :2][valid] / points[..., 2:][valid]
    weight = sure = confidence[valid]
    focal = 1.0
    for _ in range(rounds):
        focal = float((weight * (directions * pixels).sum(1)).sum() / (weight * (directions**2).sum(1)).sum())
        weight = sure / np.maximum(np.linalg.norm(pixels - focal * directions, axis=1), LEAST_ERROR_PX)
    return focal


def _chain_pairs(relative: dict[tuple[int, int], np.ndarray], matches: dict[tuple[int, int], Matches], count: int) -> np.ndarray:
    """(N, 4, 4) similarities world_from_picture along the pairs with the most matches, from the first picture on."""
    strength = {pair: len(found.confidence) for pair, found in matches.items()}
    world = {0: np.eye(4)}
    while len(world) < count:
        ahead = {pair: number for pair, number in strength.items() if pair[0] in world and pair[1] not in world}
        if not ahead:
            lost = sorted(set(range(count)) - set(world))
            raise StepError(
                f"pictures {', '.join(map(str, lost))} (counted from 0) match none of the others: they must show the same place; "
                "take pictures with more overlap, or use a method of height that needs no network"
            )
        first, second = max(ahead, key=lambda pair: (ahead[pair], pair))
        world[second] = world[first] @ relative[first, second]
    return np.stack([world[number] for number in range(count)])


@dataclass(frozen=True)
class _Pixels:
    """Pixels of all pictures together: one operation on all of them is faster than one for each picture.

    Attributes:
        picture: (M, N) 1 for the picture of each, else 0: products with it are gathered, and their gradients summed, faster than by index.
        centred: (M, 2) position about the middle of its picture.
        depth: (M,) canonical.
        cell: (M,) which of all pictures' cells bends it.
    """

    picture: Tensor
    centred: Tensor
    depth: Tensor
    cell: Tensor

    def __getitem__(self, chosen: slice) -> "_Pixels":
        return _Pixels(self.picture[chosen], self.centred[chosen], self.depth[chosen], self.cell[chosen])

    @classmethod
    def of(cls, canonical: list[CanonicalView], image: np.ndarray, pixels: np.ndarray) -> "_Pixels":
        """(M,) pictures and (M, 2) columns and rows."""
        sides = np.array([view.depth_m.shape for view in canonical])
        cells = -(-sides // CELL_PX)
        depth, cell = np.empty(len(image)), np.empty(len(image), np.int64)
        first_cell = np.concatenate([[0], np.cumsum(cells.prod(1))])
        for number, view in enumerate(canonical):
            here = image == number
            columns, rows = pixels[here].T
            depth[here] = view.depth_m[rows, columns]
            cell[here] = first_cell[number] + rows // CELL_PX * cells[number, 1] + columns // CELL_PX
        centred = pixels + 0.5 - sides[image, ::-1] / 2
        return cls(*(torch.from_numpy(values) for values in (np.eye(len(canonical))[image], centred, depth, cell)))


class _Scene(torch.nn.Module):
    """Poses, sizes, focal lengths and depths of all pictures."""

    def __init__(self, canonical: list[CanonicalView], start: np.ndarray) -> None:
        super().__init__()
        scale = np.cbrt(np.linalg.det(start[:, :3, :3]))
        self.log_size = torch.nn.Parameter(torch.from_numpy(np.log(scale)))
        self.turn = torch.nn.Parameter(torch.from_numpy(start[:, :3, :3] / scale[:, None, None]))
        size = np.exp(np.log(scale).mean())  # of the frame, which is that of the first picture
        self.place = torch.nn.Parameter(torch.from_numpy(start[:, :3, 3] / size))
        self.log_focal = torch.nn.Parameter(torch.tensor([np.log(view.focal_px) for view in canonical], dtype=torch.float64))
        cells = [-(-view.depth_m.shape[0] // CELL_PX) * -(-view.depth_m.shape[1] // CELL_PX) for view in canonical]
        self.bend = torch.nn.ParameterList(torch.zeros(count, dtype=torch.float64) for count in cells)

    def rotations(self) -> Tensor:
        """(N, 3, 3) by Gram-Schmidt from the first two columns (Zhou et al. 2019)."""
        x = torch.nn.functional.normalize(self.turn[:, :, 0], dim=1)
        y = torch.nn.functional.normalize(self.turn[:, :, 1] - (x * self.turn[:, :, 1]).sum(1, keepdim=True) * x, dim=1)
        return torch.stack([x, y, torch.linalg.cross(x, y)], dim=2)

    def depths(self, pixels: _Pixels) -> Tensor:
        """(M,) along the optical axes, bent and in the common size; the sizes' geometric mean is 1, so the network's metres stay."""
        bend = torch.cat([bend - bend.mean() for bend in self.bend])
        return pixels.depth * (bend.index_select(0, pixels.cell) + pixels.picture @ (self.log_size - self.log_size.mean())).exp()

    def in_world(self, pixels: _Pixels) -> Tensor:
        """(M, 3) points."""
        depth = self.depths(pixels)[:, None]
        rotations, places, focals = self._cameras(pixels)
        return (rotations * torch.cat([pixels.centred / focals * depth, depth], dim=1)[:, None]).sum(2) + places

    def errors_px(self, points: Tensor, pixels: _Pixels) -> Tensor:
        """(M,) how far (M, 3) points are projected from where the pictures show them."""
        rotations, places, focals = self._cameras(pixels)
        seen = (rotations * (points - places)[:, :, None]).sum(1)
        # Before a camera at least, in units of the scene, so that its projection is finite.
        return torch.linalg.norm(seen[:, :2] / seen[:, 2:].clamp(min=1e-3) * focals - pixels.centred + 1e-9, dim=1)

    def _cameras(self, pixels: _Pixels) -> tuple[Tensor, Tensor, Tensor]:
        """(M, 3, 3) rotations, (M, 3) places and (M, 1) focal lengths of the pictures that the pixels belong to."""
        each = torch.cat([self.rotations().flatten(1), self.place, self.log_focal.exp()[:, None]], dim=1)
        turn, place, focal = (pixels.picture @ each).split([9, 3, 1], dim=1)
        return turn.unflatten(1, (3, 3)), place, focal


def _optimize(canonical: list[CanonicalView], matches: dict[tuple[int, int], Matches], start: np.ndarray) -> Alignment:
    scene = _Scene(canonical, start)
    found = [matches[pair] for pair in sorted(matches)]
    images = np.repeat(np.array(sorted(matches)), [len(each.confidence) for each in found], axis=0)
    first = _Pixels.of(canonical, images[:, 0], np.concatenate([each.first for each in found]))
    second = _Pixels.of(canonical, images[:, 1], np.concatenate([each.second for each in found]))
    sure = torch.from_numpy(np.concatenate([each.confidence for each in found])).double()
    few, many = (slice(None, None, -(-len(sure) // most)) for most in (COARSE_MATCHES, FINE_MATCHES))

    def coarse() -> Tensor:
        apart = scene.in_world(first[few]) - scene.in_world(second[few])
        return (sure[few] * torch.linalg.norm(apart + 1e-9, dim=1)).sum() / sure[few].sum()

    def fine() -> Tensor:
        loss = sum((bend**2).mean() for bend in scene.bend) / DEPTH_DEVIATION**2 * BENDING_WEIGHT
        for here, there in ((first[many], second[many]), (second[many], first[many])):
            error = scene.errors_px(scene.in_world(here), there)
            loss = loss + (sure[many] * torch.log1p((error / ERROR_PX) ** 2)).sum() / sure[many].sum()
        return loss

    rigid = [scene.turn, scene.place, scene.log_size]
    with ProgressReport("aligning", COARSE_STEPS + FINE_STEPS) as report:
        _descend(coarse, rigid, COARSE_STEPS, COARSE_RATE, report)
        _descend(fine, [*rigid, scene.log_focal, *scene.bend], FINE_STEPS, FINE_RATE, report)
    with torch.no_grad():
        error_px = float(scene.errors_px(scene.in_world(first), second).median())
        return _gather_result(scene, canonical, error_px)


def _descend(loss: Callable[[], Tensor], parameters: Sequence[Tensor], steps: int, rate: float, report: ProgressReport) -> None:
    """Adam with a learning rate that falls to 0 along a cosine."""
    optimizer = torch.optim.Adam(parameters, lr=rate, betas=(0.9, 0.9))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        optimizer.zero_grad()
        value = loss()
        value.backward()
        optimizer.step()
        schedule.step()
        report.advance(1, f"loss {float(value.detach()):.4f}")


def _gather_result(scene: _Scene, canonical: list[CanonicalView], error_px: float) -> Alignment:
    world_from_camera = np.tile(np.eye(4), (len(canonical), 1, 1))
    world_from_camera[:, :3, :3], world_from_camera[:, :3, 3] = scene.rotations().numpy(), scene.place.numpy()
    depths = []
    for image, view in enumerate(canonical):
        rows, columns = np.indices(view.depth_m.shape).reshape(2, -1)
        pixels = _Pixels.of(canonical, np.full(len(rows), image), np.stack([columns, rows], axis=1))
        depths.append(scene.depths(pixels).reshape(view.depth_m.shape).numpy())
    spread = np.hypot(float(np.std(scene.log_size.numpy())), float(np.mean([view.scale_deviation for view in canonical])))
    return Alignment(
        np.linalg.inv(world_from_camera[0]) @ world_from_camera,
        scene.log_focal.exp().numpy(),
        depths,
        [view.confidence for view in canonical],
        error_px,
        float(spread / np.sqrt(len(canonical))),
    )
