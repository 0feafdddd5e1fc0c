"""COLMAP's binary model files: read and written only whole.

pycolmap reports nothing where a disk was full while it wrote, reads a cut file as far as it goes, and takes the counts in a damaged
one for true, however much memory they ask for. So the lengths that a file states are compared with its own before it is read and
after it is written. Formats: https://colmap.github.io/format.html and `src/colmap/scene/reconstruction_io_binary.cc` (COLMAP 4).
"""

import errno
import struct
from collections.abc import Callable
from pathlib import Path

import pycolmap

from zeroshop_steps.runtime.errors import StepError

CAMERA, PARAMETER_BYTES = struct.Struct("<IiQQ"), 8
IMAGE, POINT_2D_BYTES = struct.Struct("<I7dI"), 24
POINT_3D, TRACK_ELEMENT_BYTES = struct.Struct("<Q3d3Bd"), 8
RIG, SENSOR, POSE_BYTES = struct.Struct("<II"), struct.Struct("<iI"), 7 * 8
FRAME, DATA_BYTES = struct.Struct("<II7d"), 16
COUNT, SMALL_COUNT = struct.Struct("<Q"), struct.Struct("<I")


def read_reconstruction(folder: Path) -> pycolmap.Reconstruction:
    """Read a COLMAP model, binary or text.

    Raises:
        StepError: it is missing, damaged or cut off; names the file.
    """
    folder = Path(folder)
    for name in sorted(_READERS):
        if (folder / name).is_file():
            _check(folder / name)
    try:
        return pycolmap.Reconstruction(str(folder))
    except Exception as error:
        raise StepError(f"{folder} holds no readable COLMAP model ({str(error).splitlines()[0]}); run registration again") from None


def write_reconstruction(model: pycolmap.Reconstruction, folder: Path) -> None:
    """Write a binary COLMAP model into a folder, which is made where it is missing.

    Raises:
        OSError: a file could not be written whole.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        model.write_binary(str(folder))
        for name in sorted(_READERS):
            if (folder / name).is_file():
                _check(folder / name)
    except (RuntimeError, ValueError, StepError) as error:
        raise OSError(errno.ENOSPC, "the cameras could not be written whole", str(folder)) from error


def _check(path: Path) -> None:
    """Raise StepError where a file is shorter or longer than its own counts say."""
    content = path.read_bytes()
    try:
        count, end = COUNT.unpack_from(content, 0)[0], COUNT.size
        # Each entry takes bytes, so that a damaged count ends here soon.
        for _ in range(count):
            end = _READERS[path.name](content, end)
            if end > len(content):
                break
    except (struct.error, KeyError, ValueError):
        end = -1
    if end != len(content):
        raise StepError(f"{path} is damaged or cut off ({len(content)} bytes do not fit what it says of itself); run registration again")


def _skip_camera(content: bytes, at: int) -> int:
    model = CAMERA.unpack_from(content, at)[1]
    return at + CAMERA.size + PARAMETER_BYTES * _PARAMETERS[model]


def _skip_image(content: bytes, at: int) -> int:
    IMAGE.unpack_from(content, at)
    at = content.index(b"\0", at + IMAGE.size) + 1
    return at + COUNT.size + POINT_2D_BYTES * COUNT.unpack_from(content, at)[0]


def _skip_point(content: bytes, at: int) -> int:
    at += POINT_3D.size
    return at + COUNT.size + TRACK_ELEMENT_BYTES * COUNT.unpack_from(content, at)[0]


def _skip_rig(content: bytes, at: int) -> int:
    sensors = RIG.unpack_from(content, at)[1]
    at += RIG.size + (SENSOR.size if sensors else 0)
    for _ in range(max(0, sensors - 1)):
        has_pose = content[at + SENSOR.size : at + SENSOR.size + 1]
        if not has_pose:
            raise ValueError("cut")
        at += SENSOR.size + 1 + (POSE_BYTES if has_pose != b"\0" else 0)
    return at


def _skip_frame(content: bytes, at: int) -> int:
    at += FRAME.size
    return at + SMALL_COUNT.size + DATA_BYTES * SMALL_COUNT.unpack_from(content, at)[0]


def _count_parameters() -> dict[int, int]:
    """The number of parameters of each camera model, by its number in the files."""
    models = [model for name, model in pycolmap.CameraModelId.__members__.items() if name != "INVALID"]
    return {model.value: len(pycolmap.Camera.create_from_model_id(1, model, 1.0, 1, 1).params) for model in models}


_PARAMETERS = _count_parameters()
_READERS: dict[str, Callable[[bytes, int], int]] = {
    "cameras.bin": _skip_camera,
    "frames.bin": _skip_frame,
    "images.bin": _skip_image,
    "points3D.bin": _skip_point,
    "rigs.bin": _skip_rig,
}
