"""Depth in RVL (Wilson 2017, "Fast Lossless Depth Image Compression"), as image_transport's compressedDepth writes it.

A run of pixels without depth, a run of those with depth, and so on. Of the latter, differences to the one before are stored, even numbers
for positive ones. All numbers are split into groups of three bits, the lowest first; a fourth bit says whether another group follows. Eight
groups fill a word of 32 bits, little endian, from its highest bits on.
"""

import struct

import numpy as np

SIZE = struct.Struct("<ii")
MOST_PIXELS = 250_000_000
LARGEST = 2**17  # zigzag code of a difference of 16-bit numbers


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
