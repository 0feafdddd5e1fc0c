"""How two groups of cameras of one object lie to each other, by its outlines alone.

Each group's cameras fit together, and no match holds the groups to each other. The object's centre and size are known in both, and so is
up, as cameras are held upright; only the turn about it is open. Many turns are tried: each ray through a rim of the one group must pass
through the masks of the other, somewhere within the one group's own visual hull. The best turns are refined with all seven freedoms.
"""

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View, space_evenly
from zeroshop_steps.geometry.cameras.transforms import compute_scale, move_similarity
from zeroshop_steps.geometry.cameras.viewpoints import SAME_DIRECTION_DEG
from zeroshop_steps.geometry.support.ground_plane import estimate_up_from_roll
from zeroshop_steps.register.scene.image_set import REFERENCE_PX
from zeroshop_steps.register.silhouettes.coherence import bound_object, choose_rim_pixels
from zeroshop_steps.register.silhouettes.rays import look_up_many, make_outline_distance

RAYS, STEPS = 40, 192
"""Of each view, and depths along each: with 48, rays slip past thin parts, and right ways miss by 1.1 px instead of 0.1."""
TURNS, REFINED = 48, 6  # that are tried, and the best of them that are refined
MOST_PX = 30.0  # of a miss: beyond, farther is not worse
OWN_MISS_PX = -2.0  # within its own group a point of a ray may miss a mask by as much
EVALUATIONS, STEP, LOSS_PX = 25, 2e-3, 2.0  # of the refinement
FLAT_PX, FLAT_SHARE = 1.5, 0.35
"""Outlines do not say the turn where more than this share of the turns is as good as the best: 0.1 for bottles, 1 for a can."""


@dataclass(frozen=True)
class Hypothesis:
    """One way in which a group may lie to another.

    Attributes:
        target_from_source: (4, 4) similarity.
        miss_px: by how much the rays of each miss the masks of the other on average, px per 1000 px of the image.
    """

    target_from_source: np.ndarray
    miss_px: float


class CameraGroup:
    """Cameras that fit together, their masks' signed distances, and points along the rays through the rims within the group's hull."""

    def __init__(self, cameras: Sequence[Camera], masks: dict[str, np.ndarray]) -> None:
        """Take pinhole cameras and {image name: (height, width) bool} masks of their sizes."""
        self.cameras = list(cameras)
        chosen = [masks[camera.name] for camera in cameras]
        scales = [max(camera.width_px, camera.height_px) / REFERENCE_PX for camera in cameras]
        self.distances = [make_outline_distance(mask) / scale for mask, scale in zip(chosen, scales, strict=True)]
        self.centre, self.radius = bound_object(self.cameras, chosen)
        self.most_px = MOST_PX
        self.up, _ = estimate_up_from_roll([View(camera, Path(camera.name), None) for camera in cameras])
        points, counts = [], []
        for number, (camera, mask) in enumerate(zip(self.cameras, chosen, strict=True)):
            for along in self._walk(number, camera, choose_rim_pixels(mask, RAYS)):
                points.append(along)
                counts.append(len(along))
        self.points = np.concatenate(points)
        self.starts = np.concatenate([[0], np.cumsum(counts)[:-1]])

    def measure_inside(self, points: np.ndarray, without: int | None = None) -> np.ndarray:
        """(P,) least signed distance of points in the masks of all views, or all but one, px per 1000 px of the image."""
        least = np.full(len(points), np.inf)
        for number, (camera, distance) in enumerate(zip(self.cameras, self.distances, strict=True)):
            if number != without:
                pixels, depth = camera.project(points)
                least = np.minimum(least, np.where(depth > 0, look_up_many(distance, pixels), -REFERENCE_PX))
        return least

    def measure_misses(self, other: "CameraGroup", other_from_this: np.ndarray) -> np.ndarray:
        """(..., R) by how much each ray of this group misses the masks of another, by (..., 4, 4) ways to lay it there."""
        moved = self.points @ np.swapaxes(other_from_this[..., :3, :3], -1, -2) + other_from_this[..., None, :3, 3]
        inside = other.measure_inside(moved.reshape(-1, 3)).reshape(moved.shape[:-1])
        return np.clip(-np.maximum.reduceat(inside, self.starts, axis=-1), 0.0, other.most_px)

    def thin(self, views: int, rays: int, points: int, most_px: float) -> "CameraGroup":
        """The same with fewer views that judge, rays that are judged, and points of each, for a first look.

        Args:
            views, rays, points: so many of each, evenly chosen, or all where there are fewer.
            most_px: of a miss: beyond, farther is not worse.
        """
        few = copy(self)
        few.most_px = most_px
        chosen = space_evenly(len(self.cameras), views)
        few.cameras, few.distances = [self.cameras[one] for one in chosen], [self.distances[one] for one in chosen]
        every = np.split(self.points, self.starts[1:])
        thinned = [every[ray][space_evenly(len(every[ray]), points)] for ray in space_evenly(len(every), rays)]
        few.points = np.concatenate(thinned)
        few.starts = np.cumsum([0, *(len(ray) for ray in thinned[:-1])])
        return few

    def _walk(self, number: int, camera: Camera, pixels: np.ndarray) -> list[np.ndarray]:
        """For each pixel, (D, 3) points of its ray that the group's other masks allow: at least the best one."""
        world_from_camera = np.linalg.inv(camera.camera_from_world)
        rays = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(camera.intrinsics).T
        middle = float((camera.camera_from_world @ [*self.centre, 1.0])[2])
        depths = np.linspace(middle - self.radius, middle + self.radius, STEPS)
        points = (rays[:, None] * depths[:, None]).reshape(-1, 3) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
        inside = self.measure_inside(points, number).reshape(len(pixels), STEPS)
        allowed = inside >= np.minimum(OWN_MISS_PX, inside.max(1, keepdims=True))
        return [ray[keep] for ray, keep in zip(points.reshape(len(pixels), STEPS, 3), allowed, strict=True)]


def find_hypotheses(target: CameraGroup, source: CameraGroup) -> list[Hypothesis]:
    """How `source` may lie to `target`, the likeliest first; none where the outlines fit in nearly any turn."""
    turns = [_lay_upright(target, source, turn) for turn in np.linspace(0, 2 * np.pi, TURNS, endpoint=False)]
    costs = np.array([measure_misses(target, source, turn).mean() for turn in turns])
    if (costs <= costs.min() + FLAT_PX).mean() > FLAT_SHARE:
        return []
    lowest = [n for n in np.argsort(costs, kind="stable") if costs[n] <= min(costs[n - 1], costs[(n + 1) % TURNS])]
    return keep_distinct([refine(target, source, turns[number]) for number in lowest[:REFINED]])


def measure_misses(target: CameraGroup, source: CameraGroup, target_from_source: np.ndarray) -> np.ndarray:
    """(..., R) by how much each ray of each group misses the masks of the other, by (..., 4, 4) ways to lay the source to the target."""
    back = np.linalg.inv(target_from_source)
    return np.concatenate([source.measure_misses(target, target_from_source), target.measure_misses(source, back)], axis=-1)


def refine(
    target: CameraGroup,
    source: CameraGroup,
    start: np.ndarray,
    step: float = STEP,
    loss_px: float = LOSS_PX,
    evaluations: int = EVALUATIONS,
) -> Hypothesis:
    """The (4, 4) similarity near `start` with the smallest misses.

    Args:
        target, source: the groups.
        start: (4, 4) target_from_source.
        step: of the numeric derivatives, in radians and shares of the target's radius.
        loss_px: of the robust loss.
        evaluations: at most so many steps.
    """

    def moved(change: np.ndarray) -> np.ndarray:
        return move_similarity(start, change, target.centre, target.radius)

    def residuals(change: np.ndarray) -> np.ndarray:
        return measure_misses(target, source, moved(change))

    # For the derivatives, all changes in one call: a call takes longer than what it works out for one.
    def residuals_at_once(_: Callable, changes: Iterable[np.ndarray]) -> np.ndarray:
        return measure_misses(target, source, np.array([moved(change) for change in changes]))

    fit = least_squares(
        residuals, np.zeros(7), diff_step=step, loss="soft_l1", f_scale=loss_px, max_nfev=evaluations, workers=residuals_at_once
    )
    refined = moved(fit.x)
    return Hypothesis(refined, float(measure_misses(target, source, refined).mean()))


def keep_distinct(found: list[Hypothesis]) -> list[Hypothesis]:
    """Those that differ by a turn from all that miss by less, the best first."""
    distinct: list[Hypothesis] = []
    for hypothesis in sorted(found, key=lambda hypothesis: hypothesis.miss_px):
        if all(measure_between_deg(hypothesis.target_from_source, other.target_from_source) > SAME_DIRECTION_DEG for other in distinct):
            distinct.append(hypothesis)
    return distinct


def measure_between_deg(one: np.ndarray, other: np.ndarray) -> float:
    """By what angle (4, 4) similarities into one frame turn differently."""
    between = one @ np.linalg.inv(other)
    return float(np.degrees(Rotation.from_matrix(between[:3, :3] / compute_scale(between)).magnitude()))


def _lay_upright(target: CameraGroup, source: CameraGroup, turn: float) -> np.ndarray:
    """(4, 4) the similarity that lays centre on centre, up on up and size on size, turned about up by radians."""
    return lay(target, source, make_frame(target.up) @ Rotation.from_euler("z", turn).as_matrix() @ make_frame(source.up).T)


def lay(target: CameraGroup, source: CameraGroup, rotation: np.ndarray) -> np.ndarray:
    """(..., 4, 4) the similarity that lays centre on centre and size on size, turned by (..., 3, 3) rotations."""
    scale = target.radius / source.radius
    similarity = np.zeros((*rotation.shape[:-2], 4, 4))
    similarity[..., :3, :3] = scale * rotation
    similarity[..., :3, 3] = target.centre - scale * rotation @ source.centre
    similarity[..., 3, 3] = 1.0
    return similarity


def make_frame(up: np.ndarray) -> np.ndarray:
    """(3, 3) a rotation whose last column is up."""
    across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(up, across), up], axis=1)
