"""Pixels from sensor_msgs/CompressedImage, as image_transport's plugins `compressed` and `compressedDepth` write it."""

import struct
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.depth_images import check_unit, depth_to_mm
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.runtime.errors import StepError

DEPTHS = ("16UC1", "32FC1", "64FC1")
"""Encodings with which a format begins that is no colour's."""
SIZE = struct.Struct("<ii")
MOST_PIXELS = 250_000_000
LARGEST = 2**17  # zigzag code of a difference of 16-bit numbers
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
    depth_mm = np.where(raw > 0, depth_mm, 0.0).astype(np.float32)
    return check_unit(depth_mm, f"{what} in {form}", "send metres, or 16UC1 in millimetres")


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


def decode_rvl(content: bytes) -> np.ndarray:
    """(height, width) uint16 of the plugin's size (width and height, as 32-bit integers) and the stream after it.

    Raises:
        ValueError: the stream ends early, or holds other numbers than such an image has.
    """
    if len(content) < SIZE.size:
        raise ValueError(f"it has {len(content)} bytes, too few for a width and a height")
    width, height = SIZE.unpack_from(content)
    if width <= 0 or height <= 0 or width * height > MOST_PIXELS:
        raise ValueError(f"its header says that it has {width} x {height} pixels")
    numbers = _read_numbers(content[SIZE.size :])
    with_depth, differences, found = np.zeros(width * height, bool), [], 0
    place = 0
    while found < width * height:
        if place + 1 >= len(numbers):
            raise ValueError(f"it ends after {found} of {width} x {height} pixels")
        empty, full = int(numbers[place]), int(numbers[place + 1])
        run = numbers[place + 2 : place + 2 + full]
        if len(run) < full or found + empty + full > width * height or (run >= LARGEST).any():
            raise ValueError(f"it has runs that do not fit into {width} x {height} pixels, or ends within one")
        with_depth[found + empty : found + empty + full] = True
        differences.append(run)
        found, place = found + empty + full, place + 2 + full
    coded = np.concatenate(differences)
    depth = np.zeros(width * height, np.int64)
    depth[with_depth] = np.cumsum(np.where(coded % 2, -((coded + 1) // 2), coded // 2))
    if depth.min() < 0 or depth.max() > np.iinfo(np.uint16).max:
        raise ValueError("it has values beyond 16 bits")
    return depth.astype(np.uint16).reshape(height, width)


def _read_numbers(content: bytes) -> np.ndarray:
    """(N,) int64 of the groups in the stream; groups that fill up its last word count as numbers, too."""
    words = np.frombuffer(content[: len(content) // 4 * 4], "<u4")
    groups = (words[:, None] >> np.arange(28, -4, -4, dtype=np.uint32)).ravel() & 15
    last = np.flatnonzero(groups < 8)
    if not len(last):
        return np.zeros(0, np.int64)
    first = np.concatenate([[0], last[:-1] + 1])
    # Of three bits: a run may be as long as the image.
    if (last - first).max() >= 10:
        raise ValueError("it has a number of too many bits")
    groups = groups[: last[-1] + 1].astype(np.int64)
    digit = np.arange(len(groups)) - np.repeat(first, last - first + 1)
    return np.add.reduceat((groups & 7) << (3 * digit), first)
