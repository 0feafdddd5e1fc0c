"""Pixels from sensor_msgs/CompressedImage, as image_transport's plugins `compressed` and `compressedDepth` write it."""

import struct
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.depth_images import depth_to_mm
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.ros.rvl import decode_rvl
from zeroshop_steps.runtime.errors import StepError

DEPTHS = ("16UC1", "32FC1", "64FC1")
"""Encodings with which a format begins that is no colour's."""
PNG = b"\x89PNG\r\n\x1a\n"
QUANTIZATION = struct.Struct("<iff")
"""compressedDepth's header: a number, and a and b of inverse depth: a step of the picture q is a / (q - b) metres."""


def is_compressed(message: Any) -> bool:
    """Whether a message is a CompressedImage; an Image has an encoding instead of a format."""
    return hasattr(message, "format") and not hasattr(message, "encoding")


def read_compressed_color(message: Any) -> np.ndarray:
    """(height, width, 3) uint8 RGB. Raises StepError where the message holds no picture, or depth."""
    if message.format.startswith(DEPTHS) or "compressedDepth" in message.format:
        raise StepError(f"the colour image has the format {message.format!r}, which is depth; name the topic of the colour images")
    image = _decode("the colour image", message.format, bytes(message.data), cv2.IMREAD_COLOR)
    # The plugin hands its pixels to OpenCV as they are; what it then stores as blue is red, where it says so.
    return np.ascontiguousarray(image if "compressed rgb" in message.format else image[..., ::-1])


def read_compressed_depth(message: Any) -> np.ndarray:
    """(height, width) float32 in mm, 0 where nothing was measured. Raises StepError where the message holds no depth image."""
    what, form, content = "the depth image", message.format, bytes(message.data)
    if "rvl" in form.lower():
        start = QUANTIZATION.size
        raw = _decode_rvl(what, form, content[start:])
    elif (start := content.find(PNG)) >= 0:
        raw = _decode(what, form, content[start:], cv2.IMREAD_UNCHANGED)
    else:
        raise StepError(
            f"{what} has the format {form!r} and {len(content)} bytes without a PNG; expected PNG or RVL: set the publisher's"
            " compressedDepth/format to png"
        )
    if raw.ndim != 2 or raw.dtype != np.uint16:
        raise StepError(f"{what} has the format {form!r} and other pixels than 16 bits in one channel; set compressedDepth/format to png")
    if not form.startswith("32FC1"):
        return depth_to_mm(raw, 1.0, what)
    if start < QUANTIZATION.size or (scaling := QUANTIZATION.unpack_from(content))[1] <= 0:
        raise StepError(f"{what} has the format {form!r}, but no header that says how its numbers mean metres; record 16UC1, or raw images")
    _, scale, offset = scaling
    depth_mm = MM_PER_M * scale / np.where(raw > offset, raw - offset, np.inf)
    return np.where(raw > 0, depth_mm, 0.0).astype(np.float32)


def _decode_rvl(what: str, form: str, content: bytes) -> np.ndarray:
    try:
        return decode_rvl(content)
    except ValueError as error:
        raise StepError(f"{what} has the format {form!r}, but {error}; record it again, or set compressedDepth/format to png") from None


def _decode(what: str, form: str, content: bytes, flags: int) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(content, np.uint8), flags) if content else None
    if image is None:
        raise StepError(
            f"{what} has the format {form!r} and {len(content)} bytes that are no picture; expected JPEG or PNG: record it again"
        )
    return image
