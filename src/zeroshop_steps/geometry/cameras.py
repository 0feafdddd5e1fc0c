"""Cameras of an image set, as every stage after registration sees them: one pinhole camera each, OpenCV axes.

On disk they travel as COLMAP sparse models (binary). Here they are arrays.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json


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
        return -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]

    @property
    def row(self) -> np.ndarray:
        """(16,) numbers for compiled code: rotation (9) and translation (3) of camera_from_world, then fx, fy, cx, cy."""
        pose, k = self.camera_from_world, self.intrinsics
        return np.array([*pose[:3, :3].ravel(), *pose[:3, 3], k[0, 0], k[1, 1], k[0, 2], k[1, 2]])

    def project(self, points_in_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project (N, 3) points to (N, 2) pixel positions and (N,) depths along the optical axis."""
        points = points_in_world @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = points[:, :2] / points[:, 2:] * self.intrinsics[[0, 1], [0, 1]] + self.intrinsics[:2, 2]
        return pixels, points[:, 2]

    def resized(self, width_px: int, height_px: int) -> "Camera":
        """The same camera for an image resampled to another size."""
        scale = np.diag([width_px / self.width_px, height_px / self.height_px, 1.0])
        return Camera(self.name, width_px, height_px, scale @ self.intrinsics, self.camera_from_world)


@dataclass(frozen=True)
class SparseModel:
    """Registered cameras, sorted by image name, and the sparse points they share.

    Attributes:
        cameras: one entry a registered image.
        points: (P, 3) positions in the world frame of the cameras.
        colors: (P, 3) uint8 RGB.
        track_lengths: (P,) number of images that see each point.
    """

    cameras: tuple[Camera, ...]
    points: np.ndarray
    colors: np.ndarray
    track_lengths: np.ndarray


def read_sparse_model(folder: Path) -> SparseModel:
    """Read a COLMAP model (binary or text) of PINHOLE or SIMPLE_PINHOLE cameras.

    Raises:
        StepError: no such model; where the registration recorded a failure, its reason.
    """
    try:
        reconstruction = pycolmap.Reconstruction(str(folder))
    except Exception as error:
        record = folder.parent / "registration.json"
        if record.is_file() and (content := read_json(record))["status"] != "ok":
            raise StepError(f"{folder.parent}: the images could not be registered: {content['reason']}") from None
        raise StepError(f"{folder} holds no readable COLMAP model ({str(error).splitlines()[0]}); run registration again") from None
    cameras = []
    for image in sorted(reconstruction.images.values(), key=lambda image: image.name):
        if not image.has_pose:
            continue
        camera = reconstruction.cameras[image.camera_id]
        if camera.model.name not in ("PINHOLE", "SIMPLE_PINHOLE"):
            raise StepError(f"{folder}: camera model {camera.model.name} has distortion; undistort first (the register stage does)")
        camera_from_world = np.eye(4)
        camera_from_world[:3] = image.cam_from_world().matrix()
        cameras.append(Camera(image.name, camera.width, camera.height, np.array(camera.calibration_matrix()), camera_from_world))
    points = list(reconstruction.points3D.values())
    return SparseModel(
        tuple(cameras),
        np.array([point.xyz for point in points]).reshape(-1, 3),
        np.array([point.color for point in points], dtype=np.uint8).reshape(-1, 3),
        np.array([point.track.length() for point in points], dtype=int),
    )


def write_cameras(folder: Path, cameras: tuple[Camera, ...] | list[Camera]) -> None:
    """Write cameras without points as a binary COLMAP model; cameras of equal size and intrinsics share one entry."""
    reconstruction = pycolmap.Reconstruction()
    shared: dict[tuple, int] = {}
    for image_id, camera in enumerate(cameras, start=1):
        k = camera.intrinsics
        key = (camera.width_px, camera.height_px, k[0, 0], k[1, 1], k[0, 2], k[1, 2])
        if key not in shared:
            shared[key] = len(shared) + 1
            reconstruction.add_camera_with_trivial_rig(
                pycolmap.Camera(model="PINHOLE", width=key[0], height=key[1], params=list(key[2:]), camera_id=shared[key])
            )
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(camera.camera_from_world[:3, :3]), camera.camera_from_world[:3, 3])
        reconstruction.add_image_with_trivial_frame(pycolmap.Image(name=camera.name, camera_id=shared[key], image_id=image_id), pose)
    Path(folder).mkdir(parents=True, exist_ok=True)
    reconstruction.write_binary(str(folder))


def pair_with_truth(registered: Iterable[Camera], truth: Iterable[Camera]) -> list[tuple[Camera, Camera]]:
    """Registered cameras with the true ones whose images have the same stem. Raises StepError below three, too few to align by."""
    true_cameras = {Path(camera.name).stem: camera for camera in truth}
    pairs = [(camera, true_cameras[stem]) for camera in registered if (stem := Path(camera.name).stem) in true_cameras]
    if len(pairs) < 3:
        raise StepError(
            f"only {len(pairs)} registered camera(s) have a true one of the same name; three are needed to align them: register the images"
            " of this capture again"
        )
    return pairs


def align_to_truth(pairs: Iterable[tuple[Camera, Camera]]) -> np.ndarray:
    """The (4, 4) similarity truth_from_registration of such pairs, by their centres."""
    source, target = (np.array([camera.centre_in_world for camera in cameras]) for cameras in zip(*pairs, strict=True))
    return fit_similarity(source, target)


def fit_similarity(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The (4, 4) similarity target_from_source that best maps (N, 3) source to target points (Umeyama 1991, least squares)."""
    source_mean, target_mean = source.mean(0), target.mean(0)
    source_centred, target_centred = source - source_mean, target - target_mean
    u, singular, vt = np.linalg.svd(target_centred.T @ source_centred)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = (singular * np.diag(sign)).sum() / (source_centred**2).sum()
    transform = np.eye(4)
    transform[:3, :3] = scale * u @ sign @ vt
    transform[:3, 3] = target_mean - transform[:3, :3] @ source_mean
    return transform
