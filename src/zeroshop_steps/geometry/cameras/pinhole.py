"""Pinhole cameras with OpenCV axes, as every stage after registration uses them.

On disk they are COLMAP sparse models (binary); in memory they are arrays.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import ArrayLike

from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction, write_reconstruction
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure

NEAREST_MM = 1.0  # what is nearer to the plane of a camera than this is not projected: its place is all but infinite
LEAST_PAIRS = 3  # a similarity between two sets of points needs three
OFF_MEDIANS, ROUNDS = 4.0, 5  # a point that lies so many median errors off does not count; rounds until the same ones are left


def find_centre(camera_from_world: np.ndarray) -> np.ndarray:
    """(3,) centre of a camera, by its (4, 4) pose."""
    return np.asarray(-camera_from_world[:3, :3].T @ camera_from_world[:3, 3])


def make_transform(rotation: ArrayLike, translation: ArrayLike) -> np.ndarray:
    """The (4, 4) transform of a (3, 3) rotation, or scaled rotation, and a (3,) translation."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, translation
    return transform


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: x right, y down, z forward; pixel (0, 0)'s centre is at (0.5, 0.5) as in COLMAP.

    Attributes:
        name: file name of its image.
        width_px, height_px: image size.
        intrinsics: (3, 3) matrix K in pixels.
        camera_from_world: (4, 4) rigid transform, in the length unit of the model.
    """

    name: str
    width_px: int
    height_px: int
    intrinsics: np.ndarray
    camera_from_world: np.ndarray

    @property
    def centre_in_world(self) -> np.ndarray:
        """(3,) camera centre."""
        return find_centre(self.camera_from_world)

    @property
    def pinhole_params(self) -> list[float]:
        """fx, fy, cx, cy in pixels: the parameters of COLMAP's PINHOLE model."""
        k = self.intrinsics
        return [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]

    @property
    def row(self) -> np.ndarray:
        """(16,) numbers for compiled code: rotation (9) and translation (3) of camera_from_world, then fx, fy, cx, cy."""
        pose = self.camera_from_world
        return np.array([*pose[:3, :3].ravel(), *pose[:3, 3], *self.pinhole_params])

    def project(self, points_in_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project (N, 3) points to (N, 2) pixel positions and (N,) depths along the optical axis."""
        x, y, depth = self._project_by_axis(points_in_world)
        return np.stack([x, y], axis=1), depth

    def _project_by_axis(self, points_in_world: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N,) x, y and depth: arrays of their own, since loops over two or three numbers at a time are several times slower."""
        turned = points_in_world @ self.camera_from_world[:3, :3].T
        x, y, depth = (turned[:, axis] + self.camera_from_world[axis, 3] for axis in range(3))
        k = self.intrinsics
        with np.errstate(divide="ignore", invalid="ignore"):
            return x / depth * k[0, 0] + k[0, 2], y / depth * k[1, 1] + k[1, 2], depth

    def find_ray(self, x_px: float, y_px: float) -> np.ndarray:
        """(3,) unit direction, in the world, of the ray from the centre through a position of the image."""
        ray = self.camera_from_world[:3, :3].T @ np.linalg.inv(self.intrinsics) @ np.array([x_px, y_px, 1.0])
        return np.asarray(ray / np.linalg.norm(ray))

    def find_pixels(self, points_in_world: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The pixels that (N, 3) points fall into.

        Returns:
            rows, columns: (N,) int; they mean nothing where `inside` is False.
            depth: (N,) along the optical axis.
            inside: (N,) bool: the point is in front of the camera and in the image.
        """
        x, y, depth = self._project_by_axis(points_in_world)
        with np.errstate(invalid="ignore"):
            columns, rows = (np.floor(np.where(np.isfinite(along), along, -1.0)).astype(np.int64) for along in (x, y))
        inside = (depth > 0) & (columns >= 0) & (rows >= 0) & (columns < self.width_px) & (rows < self.height_px)
        return rows, columns, depth, inside

    def resized(self, width_px: int, height_px: int) -> "Camera":
        """The same camera for its image resampled to another size."""
        scale = np.diag([width_px / self.width_px, height_px / self.height_px, 1.0])
        return Camera(self.name, width_px, height_px, scale @ self.intrinsics, self.camera_from_world)

    def cropped(self, left: int, top: int, width_px: int, height_px: int) -> "Camera":
        """The same camera for a part of its image that begins at pixel (left, top), which may lie outside."""
        intrinsics = self.intrinsics.copy()
        intrinsics[:2, 2] -= (left, top)
        return Camera(self.name, width_px, height_px, intrinsics, self.camera_from_world)


@dataclass(frozen=True)
class SparseModel:
    """Registered cameras, sorted by image name, and the sparse points they share.

    Attributes:
        cameras: one entry a registered image.
        points: (P, 3) positions in the world frame of the cameras.
        colors: (P, 3) uint8 RGB.
        track_lengths: (P,) number of images that see each point.
        seen: for each camera, the rows of the points that its image sees; None where that is not known.
    """

    cameras: tuple[Camera, ...]
    points: np.ndarray
    colors: np.ndarray
    track_lengths: np.ndarray
    seen: tuple[np.ndarray, ...] | None = None


def read_sparse_model(folder: Path) -> SparseModel:
    """Read a COLMAP model (binary or text) of PINHOLE or SIMPLE_PINHOLE cameras.

    Raises:
        StepError: no such model; where the registration recorded a failure, its reason.
    """
    try:
        reconstruction = read_reconstruction(folder)
    except StepError:
        if failure := read_failure(folder.parent):
            raise StepError(f"{folder.parent}: the images could not be registered: {failure.reason}") from None
        raise
    try:
        cameras = take_cameras(reconstruction)
    except StepError as error:
        raise StepError(f"{folder}: {error}") from None
    points, rows = list(reconstruction.points3D.values()), {number: row for row, number in enumerate(reconstruction.points3D)}
    images = {image.name: image for image in reconstruction.images.values()}
    seen = [[rows[point.point3D_id] for point in images[camera.name].points2D if point.has_point3D()] for camera in cameras]
    return SparseModel(
        cameras,
        np.array([point.xyz for point in points]).reshape(-1, 3),
        np.array([point.color for point in points], dtype=np.uint8).reshape(-1, 3),
        np.array([point.track.length() for point in points], dtype=int),
        tuple(np.unique(np.array(found, dtype=int)) for found in seen),
    )


def take_cameras(model: pycolmap.Reconstruction) -> tuple[Camera, ...]:
    """The registered cameras of a model of PINHOLE or SIMPLE_PINHOLE cameras, by image name. Raises StepError where there are others."""
    cameras = []
    for image in sorted(model.images.values(), key=lambda image: image.name):
        if not image.has_pose:
            continue
        camera = model.cameras[image.camera_id]
        if camera.model.name not in ("PINHOLE", "SIMPLE_PINHOLE"):
            raise StepError(f"camera model {camera.model.name} has distortion; undistort first (the register stage does)")
        camera_from_world = to_matrix(image.cam_from_world())
        cameras.append(Camera(image.name, camera.width, camera.height, np.array(camera.calibration_matrix()), camera_from_world))
    return tuple(cameras)


def write_cameras(folder: Path, cameras: tuple[Camera, ...] | list[Camera]) -> None:
    """Write cameras without points as a binary COLMAP model; cameras of equal size and intrinsics share one entry."""
    reconstruction = pycolmap.Reconstruction()
    shared: dict[tuple, int] = {}
    for image_id, camera in enumerate(cameras, start=1):
        key = (camera.width_px, camera.height_px, *camera.pinhole_params)
        if key not in shared:
            shared[key] = len(shared) + 1
            reconstruction.add_camera_with_trivial_rig(
                pycolmap.Camera(model="PINHOLE", width=key[0], height=key[1], params=list(key[2:]), camera_id=shared[key])
            )
        image = pycolmap.Image(name=camera.name, camera_id=shared[key], image_id=image_id)
        reconstruction.add_image_with_trivial_frame(image, to_rigid(camera.camera_from_world))
    write_reconstruction(reconstruction, folder)


def to_matrix(pose: pycolmap.Rigid3d | pycolmap.Sim3d) -> np.ndarray:
    """A COLMAP pose or similarity as a (4, 4) matrix."""
    matrix = pose.matrix()
    return make_transform(matrix[:, :3], matrix[:, 3])


def to_rigid(matrix: np.ndarray) -> pycolmap.Rigid3d:
    """A (3, 4) or (4, 4) rigid transform as a COLMAP pose."""
    return pycolmap.Rigid3d(pycolmap.Rotation3d(matrix[:3, :3]), matrix[:3, 3])


def pair_with_truth(registered: Iterable[Camera], truth: Iterable[Camera]) -> list[tuple[Camera, Camera]]:
    """Pair registered cameras with the true cameras of the same image stem.

    Raises:
        StepError: fewer than three pairs, which are needed to align them.
    """
    true_cameras = {Path(camera.name).stem: camera for camera in truth}
    pairs = [(camera, true_cameras[stem]) for camera in registered if (stem := Path(camera.name).stem) in true_cameras]
    if len(pairs) < LEAST_PAIRS:
        raise StepError(
            f"only {len(pairs)} registered camera(s) have a true camera of the same name, {LEAST_PAIRS} are needed to align them;"
            " register the images of this capture again"
        )
    return pairs


def align_to_truth(pairs: Iterable[tuple[Camera, Camera]]) -> np.ndarray:
    """The (4, 4) similarity truth_from_registration that best aligns the centres of paired cameras."""
    source, target = (np.array([camera.centre_in_world for camera in cameras]) for cameras in zip(*pairs, strict=True))
    return fit_similarity(source, target)


def fit_similarity(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The (4, 4) similarity target_from_source that best maps (N, 3) source to target points (Umeyama 1991, least squares)."""
    source_mean, target_mean = source.mean(0), target.mean(0)
    source_centred, target_centred = source - source_mean, target - target_mean
    u, singular, vt = np.linalg.svd(target_centred.T @ source_centred)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = (singular * np.diag(sign)).sum() / (source_centred**2).sum()
    linear = scale * u @ sign @ vt
    return make_transform(linear, target_mean - linear @ source_mean)


def fit_similarity_robustly(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `fit_similarity`, without the points that lie far off, as single wrong cameras do; and (N,) which points counted."""
    kept = np.ones(len(source), bool)
    for _ in range(ROUNDS):
        similarity = fit_similarity(source[kept], target[kept])
        errors = np.linalg.norm(source @ similarity[:3, :3].T + similarity[:3, 3] - target, axis=1)
        near = errors <= OFF_MEDIANS * float(np.median(errors)) + 1e-12
        if near.sum() < LEAST_PAIRS or (near == kept).all():
            break
        kept = near
    return similarity, kept
