"""From tracks to exact cameras: triangulation and bundle adjustment by turns, under an error limit that shrinks."""

import copy
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.register.mapping.mapper import adjust_robustly
from zeroshop_steps.register.mapping.reregistration import ITERATIONS, MIN_ANGLE_DEG, remove_images
from zeroshop_steps.register.matching.verified_matches import verify_pairs
from zeroshop_steps.register.scene.database import create_database
from zeroshop_steps.register.scene.image_set import MIN_IMAGES
from zeroshop_steps.register.vggt.tracks import TrackObservations

ERROR_LIMITS_PX = (64.0, 32.0, 16.0, 8.0)  # before the last, per 1000 px of image width; a camera turned by one degree is wrong by 20
LOSS_SHARE = 1 / 8  # of the limit of an error: from there on, an error counts less than its square in the adjustment


def write_database(
    path: Path, names: tuple[str, ...], seen: TrackObservations, size_px: tuple[int, int], focal_px: float, seed: int
) -> None:
    """The tracks as keypoints and matches of a new COLMAP database, each image pair verified by itself, without any model.

    Keypoint k of an image is the k-th track that it sees.
    """
    create_database(path, len(names))
    with pycolmap.Database.open(path) as database:
        camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", focal_px, *size_px)
        database.write_camera(camera, use_camera_id=True)
        for index, name in enumerate(names, start=1):
            database.write_image(pycolmap.Image(name=name, camera_id=1, image_id=index), use_image_id=True)
            database.write_keypoints(index, seen.xy[index - 1, seen.seen[index - 1]].astype(np.float32))
        number = np.cumsum(seen.seen, axis=1) - 1
        pairs = []
        for first, second in combinations(range(len(names)), 2):
            both = np.flatnonzero(seen.seen[first] & seen.seen[second])
            if len(both):
                database.write_matches(
                    first + 1, second + 1, np.column_stack([number[first, both], number[second, both]]).astype(np.uint32)
                )
                pairs.append((names[first], names[second]))
    verify_pairs(path, pairs, seed)


def adjust_cameras(
    cameras: list[Camera], seen: TrackObservations, camera_model: str, max_error_px: float, rounds: int = 10
) -> pycolmap.Reconstruction:
    """Exact cameras, one lens for all, and points.

    Args:
        cameras: estimates, of images of one size.
        seen: tracks; wrong ones among them are left out.
        camera_model, max_error_px: `lens` and `max_error_px` of VggtOptions.
        rounds: iterations of bundle adjustment before points are triangulated anew.

    Returns:
        The model. An image that no point is left in keeps its estimate; points are numbered as the tracks, from 1.
    """
    width_px, height_px = cameras[0].width_px, cameras[0].height_px
    focal_px = float(np.median([np.diag(camera.intrinsics)[:2] for camera in cameras]))
    lens = pycolmap.Camera.create_from_model_name(1, camera_model, focal_px, width_px, height_px)
    poses = np.array([camera.camera_from_world[:3] for camera in cameras])
    names = [camera.name for camera in cameras]
    model = pycolmap.Reconstruction()
    for limit in (*(limit for limit in ERROR_LIMITS_PX if limit > max_error_px), max_error_px):
        limit_px = limit * width_px / 1000
        rays = lens.cam_from_img(seen.xy.reshape(-1, 2)).reshape(seen.xy.shape)
        points, errors = triangulate_tracks(poses, rays, seen.seen, limit_px / 2 / lens.mean_focal_length())
        model = _build_model(lens, poses, names, seen, points, errors * lens.mean_focal_length() <= limit_px)
        pycolmap.ObservationManager(model).filter_all_points3D(limit_px, MIN_ANGLE_DEG)
        _keep_long_tracks(model)
        if not model.num_points3D():
            return model
        adjust_robustly(model, LOSS_SHARE * limit_px, rounds if limit > max_error_px else 5 * rounds)
        lens = model.cameras[1]
        poses = np.array([model.images[index].cam_from_world().matrix() for index in range(1, len(names) + 1)])
    pycolmap.ObservationManager(model).filter_all_points3D(max_error_px * width_px / 1000, MIN_ANGLE_DEG)
    _keep_long_tracks(model)
    return model


def drop_weak_images(model: pycolmap.Reconstruction, min_observations: int, max_error_px: float) -> pycolmap.Reconstruction:
    """The model without images that have too few points, adjusted once more where that changed it."""
    few = [
        model.images[image_id].name for image_id in sorted(model.reg_image_ids()) if model.images[image_id].num_points3D < min_observations
    ]
    model = remove_images(model, few)
    _keep_long_tracks(model)
    if model.num_points3D():
        limit_px = max_error_px * model.cameras[1].width / 1000
        adjust_robustly(model, LOSS_SHARE * limit_px, ITERATIONS)
        pycolmap.ObservationManager(model).filter_all_points3D(limit_px, MIN_ANGLE_DEG)
        _keep_long_tracks(model)
    return model


def triangulate_tracks(
    poses: np.ndarray, rays: np.ndarray, seen: np.ndarray, scale: float, rounds: int = 8
) -> tuple[np.ndarray, np.ndarray]:
    """Points where rays meet, by least squares that is reweighted (Cauchy), so that single wrong rays do not count.

    Args:
        poses: (S, 3, 4) camera_from_world.
        rays: (S, N, 2) positions on the cameras' unit planes.
        seen: (S, N) bool.
        scale: error, on the unit plane, from where on a ray counts less.
        rounds: of reweighting.

    Returns:
        (N, 3) points, and (S, N) errors on the unit planes: infinite where a point is not seen or not before the camera.
    """
    # Two equations a ray: x (p3 X) - p1 X = 0, y (p3 X) - p2 X = 0 (Hartley and Zisserman 2004, section 12.2).
    rows = rays[..., None] * poses[:, None, 2:3] - poses[:, None, :2]  # (S, N, 2, 4)
    weights = seen.astype(np.float64)
    points, errors = np.zeros((seen.shape[1], 3)), np.full(seen.shape, np.inf)
    for _ in range(rounds):
        left, right = rows[..., :3], -rows[..., 3]
        system = np.einsum("sn,snki,snkj->nij", weights, left, left)
        target = np.einsum("sn,snki,snk->ni", weights, left, right)
        system += 1e-12 * np.trace(system, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-30 * np.eye(3)
        points = np.linalg.solve(system, target[..., None])[..., 0]
        inside = np.einsum("sij,nj->sni", poses[:, :, :3], points) + poses[:, None, :, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            errors = np.linalg.norm(inside[..., :2] / inside[..., 2:] - rays, axis=2)
        errors = np.where(seen & (inside[..., 2] > 0), errors, np.inf)
        # An equation's residual is the error times the depth.
        weights = np.where(seen, 1 / (np.maximum(inside[..., 2], 1e-9) ** 2 * (1 + (np.minimum(errors, 1e9) / scale) ** 2)), 0.0)
    return points, errors


def _build_model(
    lens: pycolmap.Camera, poses: np.ndarray, names: list[str], seen: TrackObservations, points: np.ndarray, kept: np.ndarray
) -> pycolmap.Reconstruction:
    """A COLMAP model of the points and those observations that are `kept` (S, N)."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(copy.copy(lens))
    number = np.cumsum(seen.seen, axis=1) - 1
    for index, name in enumerate(names):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(poses[index, :, :3]), poses[index, :, 3])
        keypoints = seen.xy[index, seen.seen[index]]
        model.add_image_with_trivial_frame(pycolmap.Image(name=name, keypoints=keypoints, camera_id=1, image_id=index + 1), pose)
    for track in np.flatnonzero(kept.sum(0) >= MIN_IMAGES):
        views = np.flatnonzero(kept[:, track])
        elements = [pycolmap.TrackElement(int(view) + 1, int(number[view, track])) for view in views]
        point = pycolmap.Point3D(xyz=points[track], color=seen.colors[track], track=pycolmap.Track(elements))
        model.add_point3D_with_id(int(track) + 1, point)
        for element in elements:
            model.images[element.image_id].set_point3D_for_point2D(element.point2D_idx, int(track) + 1)
    return model


def _keep_long_tracks(model: pycolmap.Reconstruction) -> None:
    manager = pycolmap.ObservationManager(model)
    for point_id in [point_id for point_id, point in model.points3D.items() if point.track.length() < MIN_IMAGES]:
        manager.delete_point3D(point_id)
