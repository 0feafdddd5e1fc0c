"""Pixels from and to sensor_msgs/Image, of ROS 1 and ROS 2 alike: both have the same fields.

cv_bridge is not used: Debian's is compiled for NumPy 1, and crashes beside NumPy 2.
"""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.depth_images import check_unit, depth_to_mm
from zeroshop_steps.ros.compressed_images import is_compressed, read_compressed_color, read_compressed_depth
from zeroshop_steps.runtime.errors import StepError

RGB, BGR, GRAY = (0, 1, 2), (2, 1, 0), (0, 0, 0)
COLORS = {
    **{"rgb8": (3, RGB), "bgr8": (3, BGR), "rgba8": (4, RGB), "bgra8": (4, BGR), "mono8": (1, GRAY)},
    **{"8UC1": (1, GRAY), "8UC3": (3, BGR), "8UC4": (4, BGR), "rgb16": (3, RGB), "bgr16": (3, BGR), "mono16": (1, GRAY)},
}
"""Encodings of colour: channels, and where they have red, green and blue. 8UC3 is OpenCV's order."""
RAW_COLORS = {
    # OpenCV names a Bayer pattern by its second row and column, ROS by its first.
    **{"bayer_rggb8": (1, cv2.COLOR_BayerBG2RGB), "bayer_bggr8": (1, cv2.COLOR_BayerRG2RGB)},
    **{"bayer_gbrg8": (1, cv2.COLOR_BayerGR2RGB), "bayer_grbg8": (1, cv2.COLOR_BayerGB2RGB)},
    **{"yuv422": (2, cv2.COLOR_YUV2RGB_UYVY), "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2)},
    **{"uyvy": (2, cv2.COLOR_YUV2RGB_UYVY), "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2)},  # their names since ROS 2 Iron
}
"""Encodings of colour that OpenCV converts: channels, and its name of the conversion."""
DEPTHS = {"16UC1": (np.uint16, 1.0), "mono16": (np.uint16, 1.0), "32FC1": (np.float32, 1000.0), "64FC1": (np.float64, 1000.0)}
"""Encodings of depth, with the millimetres of one step (REP 118)."""
MASKS = {
    "mono8": np.uint8,
    "8UC1": np.uint8,
    "8SC1": np.int8,
    "16UC1": np.uint16,
    "mono16": np.uint16,
    "16SC1": np.int16,
    "32SC1": np.int32,
}
LABELS = "16SC1"


def read_color(message: Any) -> np.ndarray:
    """(height, width, 3) uint8 RGB of an Image or a CompressedImage. Raises StepError where the message holds no such image."""
    if is_compressed(message):
        return read_compressed_color(message)
    what = "the colour image"
    _require(what, message, COLORS | RAW_COLORS)
    if message.encoding in RAW_COLORS:
        channels, conversion = RAW_COLORS[message.encoding]
        return cv2.cvtColor(_read_pixels(what, message, np.dtype(np.uint8), channels), conversion)
    channels, order = COLORS[message.encoding]
    deep = message.encoding.endswith("16")
    image = _read_pixels(what, message, np.dtype(np.uint16 if deep else np.uint8), channels)[..., list(order)]
    return np.ascontiguousarray((image >> 8).astype(np.uint8) if deep else image)


def read_depth(message: Any) -> np.ndarray | None:
    """(height, width) float32 in mm, 0 where nothing was measured; None of an empty message.

    Raises:
        StepError: the message holds no depth image, or one of floats that are no metres.
    """
    if is_compressed(message):
        return read_compressed_depth(message)
    if not len(message.data) and not message.width and not message.height:
        return None
    _require("the depth image", message, DEPTHS)
    kind, step_mm = DEPTHS[message.encoding]
    depth_mm = depth_to_mm(_read_pixels("the depth image", message, np.dtype(kind), 1)[..., 0], step_mm, "the depth image")
    depth_mm = np.where(np.isfinite(depth_mm) & (depth_mm > 0), depth_mm, np.float32(0))
    return depth_mm if kind is np.uint16 else check_unit(depth_mm, f"the depth image in {message.encoding}", "send metres, or 16UC1 in mm")


def read_mask(message: Any, index: int) -> np.ndarray:
    """(height, width) bool: pixels that are not 0. Raises StepError where the message holds no mask."""
    what = f"mask {index}"
    _require(what, message, MASKS)
    return _read_pixels(what, message, np.dtype(MASKS[message.encoding]), 1)[..., 0] != 0


def write_image(make: Callable[[], Any], image: np.ndarray, encoding: str, header: Any) -> Any:
    """A message with these pixels.

    Args:
        make: the message's class.
        image: (height, width) or (height, width, channels).
        encoding: by the table of sensor_msgs/image_encodings.
        header: of the message.
    """
    image = np.ascontiguousarray(image.astype(image.dtype.newbyteorder("<")))
    message = make()
    message.header, message.encoding, message.is_bigendian = header, encoding, 0
    message.height, message.width, message.step = image.shape[0], image.shape[1], image[0].nbytes
    message.data = image.tobytes()
    return message


def _require(what: str, message: Any, known: dict) -> None:
    if not len(message.data):
        raise StepError(f"{what} is empty; check that its topic sends images")
    if message.encoding not in known:
        raise StepError(f"{what} has the encoding {message.encoding!r}; expected {', '.join(known)}: convert it")


def _read_pixels(what: str, message: Any, kind: np.dtype, channels: int) -> np.ndarray:
    """(height, width, channels) of a message; rows may be padded."""
    row_bytes = message.width * channels * kind.itemsize
    step = message.step or row_bytes
    data = np.frombuffer(message.data, np.uint8)
    if not message.width or not message.height or step < row_bytes or len(data) != step * message.height:
        raise StepError(
            f"{what} of {message.width} x {message.height} px in {message.encoding} has {len(data)} bytes in rows of {message.step};"
            f" expected height x step bytes, and at least {row_bytes} bytes a row: record it again"
        )
    rows = np.ascontiguousarray(data.reshape(message.height, step)[:, :row_bytes])
    pixels = rows.view(kind.newbyteorder(">" if message.is_bigendian else "<"))
    return pixels.reshape(message.height, message.width, channels).astype(kind)
