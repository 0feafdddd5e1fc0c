"""Cameras that come with a capture: cameras.json beside images/, the common form of what labs have (docs/given-cameras.md).

    {"source": "arm of the lab", "metric": true, "position_deviation_m": 0.001, "rotation_deviation_deg": 0.3, "depth_step_mm": 1.0,
     "images": {"0001.png": {"lens": {"model": "OPENCV", "width_px": 640, "height_px": 480, "params": [...]},
                             "camera_from_world": [[...], [...], [...], [0, 0, 0, 1]]}}}

Lenses are COLMAP's models, with pixel (0, 0)'s centre at (0.5, 0.5). Poses have OpenCV axes (x right, y down, z forward) and metres; a
pose that is not known is null.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json_value, write_json

FILE = "cameras.json"
LEAST_POSES = 3  # with two, nothing can be checked
RIGID = 1e-3
"""By which a rotation's products of rows may differ from 1 and 0: files round to six digits, and single precision is enough."""
MOST_UNKNOWN = 0.5  # share of the stated poses that may hold no numbers
ASPECT = 0.01  # by which a photo's sides may be scaled differently: both are rounded


@dataclass(frozen=True)
class Lens:
    """How a camera projects.

    Attributes:
        model: COLMAP's name: PINHOLE, SIMPLE_RADIAL, OPENCV, OPENCV_FISHEYE, ...
        width_px, height_px: of its images.
        params: in COLMAP's order.
    """

    model: str
    width_px: int
    height_px: int
    params: tuple[float, ...]

    def to_colmap(self) -> pycolmap.Camera:
        """The same for COLMAP."""
        return pycolmap.Camera(model=self.model, width=self.width_px, height=self.height_px, params=list(self.params))

    def resized(self, width_px: int, height_px: int) -> "Lens":
        """The lens of its images after they were resampled."""
        camera = self.to_colmap()
        camera.rescale(width_px, height_px)
        return Lens(self.model, width_px, height_px, tuple(map(float, camera.params)))

    @staticmethod
    def pinhole(intrinsics: np.ndarray, size_px: tuple[int, int], half_px: float = 0.0) -> "Lens":
        """A lens without distortion by its (3, 3) K; `half_px` is 0.5 where that counts pixels from their centres, as OpenCV does."""
        params = (intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2] + half_px, intrinsics[1, 2] + half_px)
        return Lens("PINHOLE", *size_px, tuple(map(float, params)))


@dataclass(frozen=True)
class GivenCamera:
    """The camera of one image; `camera_from_world` is (4, 4) in metres with OpenCV axes, or None where it is not known."""

    lens: Lens
    camera_from_world: np.ndarray | None


@dataclass(frozen=True)
class GivenCameras:
    """The cameras of a capture.

    Attributes:
        images: by the image's file name.
        source: what they come from, in words.
        metric: whether lengths are metres; else their unit is unknown.
        position_deviation_m, rotation_deviation_deg: standard deviations of a camera's place, along each axis, and turn; None where nobody
            states them.
        depth_step_mm: millimetres a step of the images in depth/, if there are any.
    """

    images: Mapping[str, GivenCamera]
    source: str = "given"
    metric: bool = True
    position_deviation_m: float | None = None
    rotation_deviation_deg: float | None = None
    depth_step_mm: float | None = None
    warnings: tuple[str, ...] = field(default=(), compare=False)

    @property
    def poses(self) -> dict[str, np.ndarray]:
        """{image name: (4, 4) camera_from_world} of those that are known."""
        return {name: one.camera_from_world for name, one in self.images.items() if one.camera_from_world is not None}

    @property
    def has_poses(self) -> bool:
        """Whether enough poses are known to register by, rather than lenses alone."""
        return len(self.poses) >= LEAST_POSES

    def require(self, names: Sequence[str]) -> None:
        """Raise StepError where an image of these has no entry."""
        if missing := [name for name in names if name not in self.images]:
            raise StepError(
                f"the given cameras lack {len(missing)} of {len(names)} images, such as {missing[0]}; capture them together again"
            )

    def write(self, path: Path) -> None:
        """Write cameras.json."""
        images = {
            name: {
                "lens": {
                    "model": one.lens.model,
                    "width_px": one.lens.width_px,
                    "height_px": one.lens.height_px,
                    "params": list(one.lens.params),
                },
                "camera_from_world": None if one.camera_from_world is None else one.camera_from_world.tolist(),
            }
            for name, one in self.images.items()
        }
        facts = ("source", "metric", "position_deviation_m", "rotation_deviation_deg", "depth_step_mm")
        write_json(path, {**{name: getattr(self, name) for name in facts}, "images": images})

    def for_photos(self, names: Mapping[str, str], sizes_px: Mapping[str, tuple[int, int]], where: Path) -> "GivenCameras":
        """The cameras of photos as they are used.

        Args:
            names: {name of the photo: name as it is used}.
            sizes_px: {name of the photo: (width, height) as it is used}.
            where: the file that they come from, for messages.

        Raises:
            StepError: a photo has no entry, or another shape than its lens says.
        """
        found = {}
        for name, used in names.items():
            if name not in self.images:
                raise StepError(f"{where} has no entry for the photo {name}; add one, with null for its pose if that is not known")
            one, size_px = self.images[name], sizes_px[name]
            lens = one.lens
            if abs(lens.width_px * size_px[1] / (lens.height_px * size_px[0]) - 1) > ASPECT:
                raise StepError(
                    f"{where}: the lens of {name} has images of {lens.width_px} x {lens.height_px} px, the photo upright"
                    f" {size_px[0]} x {size_px[1]} px; were photos turned or cropped after the cameras were made?"
                )
            resized = lens if (lens.width_px, lens.height_px) == size_px else lens.resized(*size_px)
            found[used] = GivenCamera(resized, one.camera_from_world)
        return replace(self, images=found)


def read_given_cameras(path: Path) -> GivenCameras:
    """Read and check cameras.json.

    Raises:
        StepError: names the file and the image: a missing key, a lens that COLMAP does not know, a pose that is no rigid motion or is
            left-handed, half of the poses without numbers.
    """
    content = read_json_value(path)
    if not isinstance(content, dict) or not isinstance(content.get("images"), dict) or not content["images"]:
        raise StepError(f'{path} names no images; expected {{"images": {{"NAME": {{"lens": ..., "camera_from_world": ...}}}}}}')
    images, unknown = {}, []
    for name, entry in content["images"].items():
        where = f"{path}: image {name}"
        if not isinstance(entry, dict) or "lens" not in entry:
            raise StepError(f"{where} has no lens; expected its model, width_px, height_px and params")
        pose = _read_pose(entry.get("camera_from_world"), where)
        if pose is None and entry.get("camera_from_world") is not None:
            unknown.append(name)
        images[name] = GivenCamera(_read_lens(entry["lens"], where), pose)
    warnings: tuple[str, ...] = ()
    if unknown:
        warnings = (
            f"{path}: the poses of {len(unknown)} of {len(images)} images hold no numbers, and count as unknown: {unknown[0]}, ...",
        )
        if len(unknown) >= MOST_UNKNOWN * len(images):
            raise StepError(
                f"{path}: {len(unknown)} of {len(images)} poses hold NaN or no numbers, such as that of {unknown[0]}; what wrote them lost"
                " track. Write null for poses that are not known, or let cameras be estimated, without this file"
            )
    return GivenCameras(
        images,
        str(content.get("source", "given")),
        bool(content.get("metric", True)),
        _read_number(content, "position_deviation_m", path),
        _read_number(content, "rotation_deviation_deg", path),
        _read_number(content, "depth_step_mm", path),
        warnings,
    )


def check_pose(matrix: np.ndarray, where: str) -> np.ndarray:
    """A (3, 4) or (4, 4) rigid transform as (4, 4), its rotation made exact.

    Raises:
        StepError: it is no rotation, or a left-handed one.
    """
    rotation = matrix[:3, :3]
    deviation = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if deviation > RIGID:
        scale = math.sqrt(abs(float(np.trace(rotation @ rotation.T)) / 3))
        hint = f"; it scales by {scale:.3g}, divide by that" if np.abs(rotation @ rotation.T / scale**2 - np.eye(3)).max() < RIGID else ""
        raise StepError(f"{where}: the left 3 x 3 of camera_from_world is no rotation (off by {deviation:.2g}){hint}")
    if np.linalg.det(rotation) < 0:
        raise StepError(
            f"{where}: camera_from_world is left-handed (its determinant is -1): one axis is turned over, as in Unity or DirectX."
            " Turn it back: OpenCV's cameras have x right, y down, z forward, in a right-handed world"
        )
    u, _, vt = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = u @ vt, matrix[:3, 3]
    return pose


def _read_pose(value: Any, where: str) -> np.ndarray | None:
    if value is None:
        return None
    try:
        matrix = np.array(value, float)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape not in ((3, 4), (4, 4)):
        raise StepError(f"{where}: camera_from_world must be 4 rows of 4 numbers, or null")
    return check_pose(matrix, where) if np.isfinite(matrix).all() else None


def _read_lens(value: Any, where: str) -> Lens:
    try:
        lens = Lens(str(value["model"]), int(value["width_px"]), int(value["height_px"]), tuple(map(float, value["params"])))
        camera = lens.to_colmap()
        sound = camera.verify_params() and lens.width_px > 0 and lens.height_px > 0 and camera.mean_focal_length() > 0
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise StepError(f"{where}: the lens cannot be read ({error}); expected model, width_px, height_px and params of COLMAP") from None
    if not sound or not np.isfinite(lens.params).all():
        raise StepError(f"{where}: the lens {lens.model} does not take the params {list(lens.params)}; see COLMAP's camera models")
    return lens


def _read_number(content: dict[str, Any], key: str, path: Path) -> float | None:
    value = content.get(key)
    if value is None:
        return None
    if not isinstance(value, int | float) or not (math.isfinite(value) and value > 0):
        raise StepError(f"{path}: {key} is {value!r}; expected a positive number, or null")
    return float(value)
