"""nerfstudio's and instant-ngp's transforms.json, with depth and masks; also of Polycam's, Record3D's and NeRF's synthetic scenes.

Poses are world_from_camera with OpenGL's axes. Which unit they have, no key says.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.capture.adapters.form import (
    Adapter,
    GivenFrame,
    ImportedCapture,
    ImportOptions,
    choose_unit,
    read_size_px,
    require_files,
    resolve_inside,
)
from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.geometry.cameras.transforms import OPENCV_FROM_OPENGL
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

FILES = ("transforms.json", "transforms_train.json")
RADIAL, FISHEYE = ("k1", "k2", "p1", "p2"), ("k1", "k2", "k3", "k4")
PINHOLES = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
DEPTH_SCALE = 0.001  # nerfstudio's depth_unit_scale_factor where none is given: millimetres


def recognizes(folder: Path) -> bool:
    """Whether a transforms.json lies in a folder."""
    return any((folder / name).is_file() for name in FILES)


def read(folder: Path, options: ImportOptions) -> ImportedCapture:
    """All frames of the file; those of a split for tests are left alone."""
    path = next(folder / name for name in FILES if (folder / name).is_file())
    content = read_json(path)
    listed = content.get("frames")
    if not isinstance(listed, list) or not all(isinstance(frame, dict) and isinstance(frame.get("file_path"), str) for frame in listed):
        raise StepError(f"{path} lists no frames; expected frames with file_path and transform_matrix")
    files = [_add_suffix(resolve_inside(folder, frame["file_path"], path)) for frame in listed]
    require_files(files, path)
    frames = [_read_frame(folder, path, {**content, **frame}, file) for frame, file in zip(listed, files, strict=True)]
    metres = choose_unit(options, "unknown")
    unknown = "transforms.json does not say its unit, so the size stays unknown; if it is metres (Polycam, Record3D, an arm), say --unit m"
    return ImportedCapture(frames, f"{path.name} of {folder.name}", metres, () if metres else (unknown,))


def _add_suffix(path: Path) -> Path:
    """NeRF's synthetic scenes leave .png out."""
    return path if path.suffix or path.is_file() else path.with_name(path.name + ".png")


def _read_frame(folder: Path, path: Path, entry: dict[str, Any], image: Path) -> GivenFrame:
    try:
        matrix = np.array(entry["transform_matrix"], float)
    except (KeyError, TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape not in ((3, 4), (4, 4)):
        raise StepError(f"{path}: {entry['file_path']} has no transform_matrix of 4 rows of 4 numbers; add it, or take that frame out")
    world_from_camera = np.vstack([matrix[:3], [0.0, 0.0, 0.0, 1.0]])
    finite = np.isfinite(world_from_camera).all() and abs(np.linalg.det(world_from_camera)) > 0
    pose = OPENCV_FROM_OPENGL @ np.linalg.inv(world_from_camera) if finite else np.full((4, 4), np.nan)
    places = {key: resolve_inside(folder, entry[key], path) for key in ("mask_path", "depth_file_path") if isinstance(entry.get(key), str)}
    require_files(list(places.values()), path)
    try:
        step_mm = 1000.0 * float(entry.get("depth_unit_scale_factor", DEPTH_SCALE))
    except (TypeError, ValueError):
        step_mm = 0.0
    if not (math.isfinite(step_mm) and step_mm > 0):
        raise StepError(
            f"{path}: depth_unit_scale_factor is {entry['depth_unit_scale_factor']!r}; expected metres of a step of depth, such as 0.001"
        )
    return GivenFrame(image, _read_lens(path, entry, image), pose, places.get("mask_path"), places.get("depth_file_path"), step_mm)


def _read_lens(path: Path, entry: dict[str, Any], image: Path) -> Lens:
    """The lens of a frame: its own keys, else those of the file."""
    try:
        if "w" in entry and "h" in entry:
            width, height = int(entry["w"]), int(entry["h"])
        else:
            width, height = read_size_px(image)
        fx = float(entry["fl_x"]) if "fl_x" in entry else 0.5 * width / math.tan(0.5 * float(entry["camera_angle_x"]))
        fy = float(entry["fl_y"]) if "fl_y" in entry else fx
        if "fl_y" not in entry and "camera_angle_y" in entry:
            fy = 0.5 * height / math.tan(0.5 * float(entry["camera_angle_y"]))
        middle = float(entry.get("cx", width / 2)), float(entry.get("cy", height / 2))
        model = str(entry.get("camera_model", "OPENCV"))
        fisheye = model == "OPENCV_FISHEYE" or bool(entry.get("is_fisheye"))
        distortion = tuple(float(entry.get(key) or 0.0) for key in (FISHEYE if fisheye else RADIAL))
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise StepError(
            f"{path}: {entry['file_path']} has no lens ({error}); expected fl_x and fl_y in pixels, or camera_angle_x"
        ) from None
    if not fisheye and model not in PINHOLES:
        raise StepError(
            f"{path}: the camera_model {model} is no lens of an object's photo; expected {', '.join(PINHOLES)} or OPENCV_FISHEYE"
        )
    if not fisheye and not any(distortion):
        return Lens("PINHOLE", width, height, (fx, fy, *middle))
    return Lens("OPENCV_FISHEYE" if fisheye else "OPENCV", width, height, (fx, fy, *middle, *distortion))


ADAPTER = Adapter("nerfstudio's or instant-ngp's folder", "transforms.json beside its images", recognizes, read, 3)
