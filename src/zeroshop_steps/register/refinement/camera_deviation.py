"""How surely each camera of a registration is held: `camera_deviation.csv` beside it, of the model and the masks as they were written.

The covariance of an adjustment is the inverse of its normal matrix, with the points eliminated, times the variance of the errors that
are left (Triggs et al., Bundle Adjustment: A Modern Synthesis, 1999, sections 6 and 9). Where the world lies, and its scale, no
adjustment tells. Here they count as chosen so that the object lies as near as possible to its place in all views together: a camera's
deviation is against all the others, not against an arbitrary first one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import DEVIATIONS, View, read_views
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.geometry.cameras.transforms import make_cross_matrices
from zeroshop_steps.geometry.support.scene_support import find_focus
from zeroshop_steps.register.scene.record import Evidence, Finding
from zeroshop_steps.register.silhouettes.bundle_adjustment import SilhouetteAdjustment
from zeroshop_steps.register.silhouettes.coherence import bound_object
from zeroshop_steps.register.silhouettes.model_adjustment import read_tracks
from zeroshop_steps.register.silhouettes.state import NO_TRACKS, Tracks
from zeroshop_steps.register.silhouettes.view_poses import UNKNOWNS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import write_table

LOOSE_SHARE = 0.006
"""Mean deviation of the cameras' centres, of their distance, at strength 1. In 111 models of 11 rendered captures, with keypoints not yet
refined, it is at most 0.0054 in right ones (95 %: 0.0039), and 0.0045 to 0.0086 where cameras are bent by 1.6 to 4 % of the diameter."""
USUAL_SHARE = 0.25  # of an image's shorter side that an object's radius has, where no mask shows it
LOOSE = 0.1
"""Deviation that an unknown has before anything is observed, in radians, radii of the object, and as a logarithm of the focal length: what
no observation holds stays finite."""
LEAST_NOISE_PX = 0.05  # of an observation; less is no measurement, but an adjustment that could follow its errors
ENDS = np.array([[0.0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
"""(5, 3) where deviations count, about the object's centre in its radii, along the axes of each camera: in its middle, and at its ends
across the view. Those along it may lie close to a camera that is near."""


@dataclass(frozen=True)
class CameraDeviations:
    """Standard deviations of N cameras.

    Attributes:
        names: of their images.
        object_px: (N,) of where the object's middle and ends lie in the image, in pixels: root of the mean square of their distance.
        rotation_deg: (N,) of the camera's turn.
        centre_share: (N,) of its centre, as a share of the distance to the object.
    """

    names: tuple[str, ...]
    object_px: np.ndarray
    rotation_deg: np.ndarray
    centre_share: np.ndarray


def write_deviations(folder: Path, by_outlines: bool) -> dict[str, Any]:
    """Write camera_deviation.csv into a folder with images/, sparse/ and perhaps masks/.

    Args:
        by_outlines: whether the masks' rims had a part in the cameras; then they do in the deviations.

    Returns:
        What registration.json says of them. Nothing is written, and this is empty, where there are no masks and the cameras look away
        from each other, at no object: `record_view_coverage` advises what to do then.
    """
    try:
        found = measure_deviations(read_views(folder)[0], folder / "sparse", by_outlines)
    except StepError:
        return {}
    rows = [
        {"image": name, "deviation_px": f"{px:.4f}", "rotation_deg": f"{angle:.5f}", "centre_share": f"{share:.6f}"}
        for name, px, angle, share in zip(found.names, found.object_px, found.rotation_deg, found.centre_share, strict=True)
    ]
    write_table(folder / DEVIATIONS, rows)
    usual, largest = np.median(found.object_px), found.object_px.max()
    return {"deviation_px": {"median": round(float(usual), 3), "largest": round(float(largest), 3)}}


def check_deviations(folder: Path, by_outlines: bool) -> Evidence:
    """How loosely the cameras of a folder are held; arguments as of `write_deviations`."""
    try:
        share = float(measure_deviations(read_views(folder)[0], folder / "sparse", by_outlines).centre_share.mean())
    except StepError:
        return Evidence()
    found = f"the standard deviation of a camera's place is {share:.1%} of its distance in the mean"
    return Evidence(findings=(Finding("deviation", share / LOOSE_SHARE, found),))


def measure_deviations(views: list[View], sparse: Path, by_outlines: bool) -> CameraDeviations:
    """Deviations of the cameras of a registration, whose sparse model lies in a folder.

    Raises:
        StepError: there are no masks, and the cameras look away from each other.
    """
    model = read_reconstruction(sparse)
    cameras = [view.camera for view in views]
    ids, tracks = read_tracks(model, cameras)
    points = np.array([model.points3D[point_id].xyz for point_id in ids]).reshape(-1, 3)
    tracks, points = _keep_in_front(cameras, tracks, points)
    centre, radius, told = *_find_object(views), None
    if by_outlines:
        adjustment = SilhouetteAdjustment(cameras, {view.camera.name: view.mask() for view in views}, NO_TRACKS)
        centre, radius, told = adjustment.centre, adjustment.radius, adjustment.measure_information()
    return estimate_deviations(cameras, tracks, points, centre, radius, told)


def _keep_in_front(cameras: list[Camera], tracks: Tracks, points: np.ndarray) -> tuple[Tracks, np.ndarray]:
    """The tracks without observations of points behind their camera, and without points that fewer than two views are left of."""
    axes = np.array([camera.camera_from_world[2] for camera in cameras])
    depth = (axes[tracks.view, :3] * points[tracks.point]).sum(1) + axes[tracks.view, 3]
    kept = depth > 0
    kept &= np.bincount(tracks.point[kept], minlength=len(points))[tracks.point] > 1
    used, numbers = np.unique(tracks.point[kept], return_inverse=True)
    return Tracks(tracks.view[kept], numbers, tracks.pixels[kept]), points[used]


def _find_object(views: list[View]) -> tuple[np.ndarray, float]:
    """Centre and radius of a sphere about what the masks show; without masks, about what all cameras look at."""
    masks = [(view.camera, view.mask()) for view in views if view.mask_path is not None]
    shown = [(camera, mask) for camera, mask in masks if mask.any()]
    if len(shown) > 1:
        return bound_object([camera for camera, _ in shown], [mask for _, mask in shown])
    cameras = [view.camera for view in views]
    centre = find_focus(cameras)
    sides = [
        USUAL_SHARE * min(camera.width_px, camera.height_px) / camera.intrinsics[0, 0] * np.linalg.norm(centre - camera.centre_in_world)
        for camera in cameras
    ]
    return centre, float(np.median(sides))


def estimate_deviations(
    cameras: Sequence[Camera], tracks: Tracks, points: np.ndarray, centre: np.ndarray, radius: float, by_outlines: np.ndarray | None = None
) -> CameraDeviations:
    """Deviations of adjusted cameras, as their tracks and outlines hold them; all focal lengths have one unknown factor.

    Args:
        cameras: N pinhole cameras.
        tracks, points: what they were adjusted to; the (P, 3) points in the world of the cameras.
        centre, radius: of a sphere about the object, in that world.
        by_outlines: (6 N + 1, 6 N + 1) what outlines tell of them, as `SilhouetteAdjustment.measure_information` has it; None without.
    """
    poses = np.array([camera.camera_from_world for camera in cameras])
    rotation, place = poses[:, :3, :3], (poses @ np.append(centre, 1.0))[:, :3] / radius
    intrinsics = np.array([camera.intrinsics for camera in cameras])
    information = _find_information(rotation, place, intrinsics, tracks, (points - centre) / radius)
    root = _invert_root(information if by_outlines is None else information + by_outlines)

    shown = (ENDS @ rotation).reshape(-1, 3)
    view = np.repeat(np.arange(len(cameras)), len(ENDS))
    by_camera, by_point, _ = _differentiate(rotation, place, intrinsics, view, shown)
    effect = by_camera.toarray()
    # How a turn, a shift and a change of scale of the world move what is shown.
    by_world = np.concatenate([by_point @ -make_cross_matrices(shown), by_point, by_point @ shown[:, :, None]], axis=2).reshape(-1, 7)
    world_from_cameras = -np.linalg.lstsq(by_world, effect, rcond=None)[0]
    moved = effect + by_world @ world_from_cameras
    variance = ((moved @ root) ** 2).sum(1).reshape(len(cameras), -1)

    by_pose = np.eye(len(root)) + _follow_world(rotation, place) @ world_from_cameras
    return CameraDeviations(
        tuple(camera.name for camera in cameras),
        np.sqrt(variance.sum(1) / len(ENDS)),
        *_find_pose_deviations(rotation, place, by_pose @ root),
    )


def _invert_root(information: np.ndarray) -> np.ndarray:
    """(K, K) R with R R^T the inverse of an information matrix. Rounding does not make any unknown looser than it was at first."""
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    return np.asarray(vectors / np.sqrt(np.maximum(values, 1 / LOOSE**2)))


def _find_pose_deviations(rotation: np.ndarray, place: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) deviations of the cameras' turns, in degrees, and of their centres, as shares of the distance; by a root of their covariance."""
    turns, centres = [], []
    for index, (turned, there) in enumerate(zip(rotation, place, strict=True)):
        own = slice(UNKNOWNS * index, UNKNOWNS * (index + 1))
        pose = root[own]
        # The centre is -R^T t, and a turn about the object takes it along.
        centre_by_pose = np.concatenate([make_cross_matrices(-(turned.T @ there)[None])[0], -turned.T], axis=1)
        turns.append(np.linalg.norm(pose[:3]))
        centres.append(np.linalg.norm(centre_by_pose @ pose) / np.linalg.norm(there))
    return np.degrees(turns), np.array(centres)


def _find_information(rotation: np.ndarray, place: np.ndarray, intrinsics: np.ndarray, tracks: Tracks, points: np.ndarray) -> np.ndarray:
    """(6 N + 1, 6 N + 1) what tracks tell of the cameras' unknowns, with the points eliminated.

    Errors weigh as under Cauchy's loss, whose scale is the median error: points aligned by the pictures are several times as exact as
    those that are not, and nothing tells the two apart but how well they fit.
    """
    jacobian, by_point, pixels = _differentiate(rotation, place, intrinsics, tracks.view, points[tracks.point])
    size, count = jacobian.shape[1], len(points)
    squares = ((pixels - tracks.pixels) ** 2).sum(1)
    loose = np.eye(size) / LOOSE**2
    if not count:
        return loose
    weight = 1 / (1 + squares / max(float(np.median(squares)), LEAST_NOISE_PX**2))
    free = max(2 * len(squares) - 3 * count - size + 7, 1) / len(squares)
    variance = max(float(weight @ squares / weight.sum() / free), LEAST_NOISE_PX**2)
    weighed = jacobian.multiply(np.repeat(weight, 2)[:, None]).tocsr()
    columns = np.repeat(3 * tracks.point[:, None] + np.arange(3), 2, axis=0)
    of_points = csr_matrix((by_point.ravel(), columns.ravel(), 3 * np.arange(2 * len(squares) + 1)), (2 * len(squares), 3 * count))
    own = np.zeros((count, 3, 3))
    np.add.at(own, tracks.point, np.einsum("o,ori,orj->oij", weight, by_point, by_point))
    inverse = np.linalg.inv(own + np.eye(3) * variance / LOOSE**2)
    coupling = (weighed.T @ of_points).tocsr()
    rows = np.repeat(3 * np.arange(count)[:, None] + np.arange(3), 3, axis=1).reshape(-1, 3, 3)
    inverses = csr_matrix((inverse.ravel(), (rows.ravel(), rows.transpose(0, 2, 1).ravel())), (3 * count, 3 * count))
    normal = (weighed.T @ jacobian - coupling @ inverses @ coupling.T).toarray()
    return normal / variance + loose


def _follow_world(rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(6 N + 1, 7) how the cameras' unknowns change where the world is turned, shifted and scaled, and they look the same."""
    count = len(rotation)
    change = np.zeros((count, UNKNOWNS, 7))
    change[:, :3, :3] = np.eye(3)
    change[:, 3:, 3:6] = rotation
    change[:, 3:, 6] = -place
    return np.concatenate([change.reshape(-1, 7), np.zeros((1, 7))])


def _differentiate(
    rotation: np.ndarray, place: np.ndarray, intrinsics: np.ndarray, view: np.ndarray, points: np.ndarray
) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
    """Where points lie in views: derivatives by the (6 N + 1) unknowns of the cameras, (2 K, 6 N + 1), and by the points, (K, 2, 3);
    and the (K, 2) pixels."""
    inside = np.einsum("kij,kj->ki", rotation[view], points) + place[view]
    focal = intrinsics[view][:, [0, 1], [0, 1]]
    slopes = inside[:, :2] / inside[:, 2:]
    by_inside = np.zeros((len(view), 2, 3))
    by_inside[:, [0, 1], [0, 1]] = focal / inside[:, 2:]
    by_inside[:, :, 2] = -focal * slopes / inside[:, 2:]
    by_point = by_inside @ rotation[view]
    jacobian = np.concatenate([-by_point @ make_cross_matrices(points), by_inside, (focal * slopes)[..., None]], axis=2)
    size = UNKNOWNS * len(rotation) + 1
    columns = np.concatenate([UNKNOWNS * view[:, None] + np.arange(UNKNOWNS), np.full((len(view), 1), size - 1)], axis=1)
    columns = np.repeat(columns, 2, axis=0)
    starts = np.arange(len(columns) + 1) * columns.shape[1]
    sparse = csr_matrix((jacobian.ravel(), columns.ravel(), starts), (len(columns), size))
    return sparse, by_point, focal * slopes + intrinsics[view][:, :2, 2]
