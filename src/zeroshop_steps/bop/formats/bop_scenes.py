"""Scenes in BOP's layout: cameras, true poses, visibility, and the paths of the images.

Camera matrices are BOP's here: the centre of pixel (0, 0) is at (0, 0). `Frame.camera` gives the project's own camera, in which it is
at (0.5, 0.5).
"""

import functools
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.bop.formats.pose_checks import check_rotations, check_translations, make_transform
from zeroshop_steps.bop.formats.schema import read_validated
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.imaging.depth_images import check_unit, depth_to_mm
from zeroshop_steps.geometry.imaging.image_files import read_size_px
from zeroshop_steps.geometry.imaging.images import decode_image, read_image, read_mask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json

HALF_PX = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
"""The project's intrinsics minus BOP's: the project counts pixels from their corners, BOP from their centres."""
FOLDER_NAME = re.compile(r"(obj_)?(?P<number>\d+)(_up|_down)?")
"""Of scenes, `000048`, and of onboarding sequences, `obj_000005_up`, `obj_000005_down` (static) and `obj_000005` (dynamic)."""
IMAGE_SUFFIXES = (".png", ".jpg", ".tif")
LEAST_FOCAL_PX = 10.0  # less is that of a camera matrix for an image of width 1


@dataclass(frozen=True)
class Instance:
    """One annotated object in an image.

    Attributes:
        object_id: its model.
        camera_from_model: (4, 4) true pose, mm.
        visible_share: visible share of its silhouette, 0..1; None if the dataset does not say.
        info: its entry of scene_gt_info.json.
    """

    object_id: int
    camera_from_model: np.ndarray
    visible_share: float | None
    info: dict


@dataclass(frozen=True)
class Frame:
    """One image of a scene.

    Attributes:
        scene_id, image_id: BOP's numbers.
        intrinsics: (3, 3) BOP's K; pixel centres are whole numbers.
        depth_scale: millimetres per step of the depth image; None if there is none.
        camera_from_world: (4, 4) in mm, or None.
        instances: in the order of scene_gt.json.
        folder: the scene's folder.
    """

    scene_id: int
    image_id: int
    intrinsics: np.ndarray
    depth_scale: float | None
    camera_from_world: np.ndarray | None
    instances: tuple[Instance, ...]
    folder: Path

    @property
    def name(self) -> str:
        """Its name in messages."""
        return f"scene {self.scene_id}, image {self.image_id}"

    def image_path(self, kind: str, instance: int | None = None) -> Path | None:
        """The path of its `rgb`, `gray` or `depth`, or of an instance's `mask` or `mask_visib`; None if there is no such file."""
        place = self.folder / kind
        if place.is_file():
            raise StepError(f"{place} is a file, not a folder of images, such as a link that was copied as text; put the folder there")
        stem = f"{self.image_id:06d}" + ("" if instance is None else f"_{instance:06d}")
        found = [place / f"{stem}{suffix}" for suffix in IMAGE_SUFFIXES if (place / f"{stem}{suffix}").is_file()]
        if not found:  # other programs write other zeros before the numbers
            same = re.compile("_".join(f"0*{number}" for number in (self.image_id, instance) if number is not None))
            found = sorted(path for path in place.glob("*.*") if same.fullmatch(path.stem))
        path = next((path for path in found if path.suffix in IMAGE_SUFFIXES), None)
        if path is None and found:
            raise StepError(f"image {found[0]} is of a format that is not read here; export it as {', '.join(IMAGE_SUFFIXES)}")
        return path

    def photo_path(self) -> Path:
        """The path of its colour image, otherwise of its gray one. Raises StepError if there is neither."""
        path = self.image_path("rgb") or self.image_path("gray")
        if path is None:
            raise StepError(f"{self.folder} has no picture {self.image_id:06d} ({self.name}) in rgb or gray; add it")
        return path

    def color(self) -> np.ndarray | None:
        """(height, width, 3) uint8 colour image; None if there is none."""
        path = self.image_path("rgb")
        return None if path is None else read_image(path)

    @property
    def has_depth(self) -> bool:
        """Whether depth was measured."""
        return self.image_path("depth") is not None

    def depth_mm(self) -> np.ndarray:
        """(height, width) float32 measured depth along the optical axis in mm, 0 where there is none.

        Raises:
            StepError: the depth image is missing or cannot be read, or there is no depth scale.
        """
        path = self.image_path("depth")
        if path is None:
            raise StepError(
                f"{self.folder / 'depth'} has no image {self.image_id:06d} ({self.name}); VSD compares with measured depth:"
                " add it, or leave vsd out of --errors"
            )
        if self.depth_scale is None:
            raise StepError(
                f"{self.folder / 'scene_camera.json'}: image {self.image_id} has depth but no depth_scale, and neither has a camera.json of"
                " its dataset; add it"
            )
        raw = decode_image(path, cv2.IMREAD_UNCHANGED)
        if raw.ndim != 2 or raw.dtype != np.uint16:
            raise StepError(
                f"depth image {path} has {1 if raw.ndim == 2 else raw.shape[2]} channel(s) of {raw.dtype}; expected one of whole numbers of"
                " 16 bits: export it again as 16-bit PNG"
            )
        depth_mm = depth_to_mm(raw, self.depth_scale, f"depth image {path}")
        check_depth(depth_mm, self, None if (photo := self.image_path("rgb") or self.image_path("gray")) is None else read_size_px(photo))
        return depth_mm

    def mask(self, instance: int, kind: str = "mask_visib") -> np.ndarray:
        """(height, width) bool: an instance's visible pixels, or with `mask` its whole silhouette. Raises StepError without the file."""
        path = self.image_path(kind, instance)
        if path is None:
            raise StepError(
                f"{self.folder / kind} has no {self.image_id:06d}_{instance:06d}.png, the mask of an instance in scene_gt.json;"
                " python -m zeroshop_steps.bop --method take_test_set makes masks from the true poses, the models and the depth images"
            )
        return read_mask(path)

    def size_px(self) -> tuple[int, int] | None:
        """(width, height) of its images; None if there are none."""
        for kind in ("depth", "rgb", "gray"):
            path = self.image_path(kind)
            if path is not None:
                return read_size_px(path)
        return None

    def camera(self, width_px: int, height_px: int) -> Camera:
        """The project's camera of this image; its world frame is the camera's own."""
        shift = np.eye(3) + HALF_PX
        return Camera(f"{self.image_id:06d}.png", width_px, height_px, shift @ self.intrinsics, np.eye(4))


def check_depth(depth_mm: np.ndarray, frame: Frame, photo_px: tuple[int, int] | None) -> None:
    """Check the (height, width) depth of a frame against the (width, height) of its photo, if it has one.

    Raises:
        StepError: they have other sizes, or depth has another unit than it says.
    """
    if photo_px is not None and depth_mm.shape[::-1] != photo_px:
        raise StepError(
            f"{frame.image_path('depth') or 'the depth image'} is {depth_mm.shape[1]} x {depth_mm.shape[0]} px, its colour image is"
            f" {photo_px[0]} x {photo_px[1]} px; align depth with colour first"
        )
    remedy = f"correct depth_scale in {frame.folder / 'scene_camera.json'}, which is millimetres per step of the depth image"
    check_unit(depth_mm, f"the depth of {frame.name}", f"in files, {remedy}; elsewhere, give millimetres")


def read_scene(folder: Path, truth_needed: bool = True) -> dict[int, Frame]:
    """Read scene_camera.json, scene_gt.json and, if it exists, scene_gt_info.json from a scene's folder.

    Args:
        folder: named by the scene's number, or as an onboarding sequence, by the object's.
        truth_needed: if False, scene_gt.json may be missing, as for images without annotations.

    Returns:
        The images with true poses, by number. Without scene_gt.json, all images, without instances.

    Raises:
        StepError: a file is missing or has the wrong form, a depth scale is not positive, or a pose is no pose in millimetres.
    """
    folder = Path(folder)
    if not FOLDER_NAME.fullmatch(folder.name):
        raise StepError(f"{folder} is not named by a scene's number, such as 000048, or as an onboarding sequence, such as obj_000005_up")
    cameras = read_validated(folder / "scene_camera.json", "scene_camera")
    if not truth_needed and not (folder / "scene_gt.json").is_file():
        return {int(number): _make_frame(folder, int(number), camera, [], []) for number, camera in cameras.items()}
    truth = read_validated(folder / "scene_gt.json", "scene_gt")
    has_info = (folder / "scene_gt_info.json").is_file()
    info = read_validated(folder / "scene_gt_info.json", "scene_gt_info") if has_info else {}
    _check_poses(folder, truth)
    frames = {}
    for number, instances in truth.items():
        if number not in cameras:
            raise StepError(f"{folder / 'scene_camera.json'} lacks image {number}, which scene_gt.json has")
        details = info.get(number, [{}] * len(instances))
        if len(details) != len(instances):
            raise StepError(
                f"{folder / 'scene_gt_info.json'}: image {number} has {len(details)} instances, scene_gt.json has {len(instances)};"
                " the two files must list the same"
            )
        frames[int(number)] = _make_frame(folder, int(number), cameras[number], instances, details)
    return frames


def write_scene(folder: Path, frames: list[Frame]) -> None:
    """Write the three JSON files of a scene; the caller writes the images."""
    cameras: dict[str, dict[str, Any]] = {}
    truth, info = {}, {}
    for frame in frames:
        key = str(frame.image_id)
        cameras[key] = {"cam_K": frame.intrinsics.ravel().tolist()}
        if frame.depth_scale is not None:
            cameras[key]["depth_scale"] = frame.depth_scale
        if frame.camera_from_world is not None:
            cameras[key]["cam_R_w2c"] = frame.camera_from_world[:3, :3].ravel().tolist()
            cameras[key]["cam_t_w2c"] = frame.camera_from_world[:3, 3].tolist()
        truth[key] = [
            {
                "cam_R_m2c": instance.camera_from_model[:3, :3].ravel().tolist(),
                "cam_t_m2c": instance.camera_from_model[:3, 3].tolist(),
                "obj_id": instance.object_id,
            }
            for instance in frame.instances
        ]
        info[key] = [instance.info for instance in frame.instances]
    write_json(Path(folder) / "scene_camera.json", cameras)
    write_json(Path(folder) / "scene_gt.json", truth)
    write_json(Path(folder) / "scene_gt_info.json", info)


def list_scenes(split: Path) -> dict[int, Path]:
    """The folders of a split's scenes, such as `test/000001`, by number. Raises StepError if there are none."""
    split = Path(split)
    names = sorted(os.listdir(split)) if split.is_dir() else []
    folders = {int(name): split / name for name in names if name.isdigit() and (split / name / "scene_camera.json").is_file()}
    if not folders:
        raise StepError(f"{split} holds no scene; expected folders such as 000001 with scene_camera.json and scene_gt.json")
    return folders


def _make_frame(folder: Path, number: int, camera: dict, instances: list[dict], details: list[dict]) -> Frame:
    scale = camera.get("depth_scale", _find_depth_scale(folder.resolve().parents[1]))
    if scale is not None and scale <= 0:
        raise StepError(
            f"{folder / 'scene_camera.json'}: depth_scale of image {number} is {scale:g}; expected the positive number of millimetres"
            " that one step of the depth image means"
        )
    intrinsics = np.array(camera["cam_K"], float).reshape(3, 3)
    if min(intrinsics[0, 0], intrinsics[1, 1]) < LEAST_FOCAL_PX:
        raise StepError(
            f"{folder / 'scene_camera.json'}: cam_K of image {number} has the focal lengths {intrinsics[0, 0]:g} and {intrinsics[1, 1]:g};"
            " expected pixels, and K row by row"
        )
    world = None
    if "cam_R_w2c" in camera and "cam_t_w2c" in camera:
        world = make_transform(np.array(camera["cam_R_w2c"], float).reshape(3, 3), np.array(camera["cam_t_w2c"], float))
    read = tuple(
        Instance(
            entry["obj_id"],
            make_transform(np.array(entry["cam_R_m2c"], float).reshape(3, 3), np.array(entry["cam_t_m2c"], float)),
            detail.get("visib_fract"),
            detail,
        )
        for entry, detail in zip(instances, details, strict=True)
    )
    found = FOLDER_NAME.fullmatch(folder.name)
    assert found is not None, "read_scene checked its name"
    return Frame(int(found["number"]), number, intrinsics, scale, world, read, folder)


@functools.cache
def _find_depth_scale(dataset: Path) -> float | None:
    """The depth scale in the camera files of a dataset, such as camera.json, if they agree on one."""
    found = {read_json(path).get("depth_scale") for path in sorted(dataset.glob("camera*.json"))}
    return float(scale) if len(found) == 1 and isinstance(scale := found.pop(), int | float) else None


def _check_poses(folder: Path, truth: dict) -> None:
    entries = [(f"image {number}, instance {index}", entry) for number, found in truth.items() for index, entry in enumerate(found)]
    names = [name for name, _ in entries]
    path = folder / "scene_gt.json"
    check_rotations(np.array([entry["cam_R_m2c"] for _, entry in entries], float).reshape(-1, 3, 3), names, path)
    check_translations(np.array([entry["cam_t_m2c"] for _, entry in entries], float).reshape(-1, 3), names, path)
