"""Compressed messages and depth with rotated bits give the pixels of the raw ones."""

import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from zeroshop_steps.geometry.imaging.depth_images import depth_to_mm
from zeroshop_steps.ros.image_messages import read_color, read_depth
from zeroshop_steps.runtime.errors import StepError

PHOTO = cv2.resize(np.random.default_rng(0).integers(0, 255, (4, 6, 3), dtype=np.uint8), (48, 32))
DEPTH_MM = np.random.default_rng(1).integers(500, 3000, (32, 48)).astype(np.uint16)
HEADER = struct.pack("<iff", 0, 0, 0)


def compressed(form: str, content: bytes) -> SimpleNamespace:
    return SimpleNamespace(format=form, data=np.frombuffer(content, np.uint8))


def encode(image: np.ndarray, suffix: str = ".png") -> bytes:
    return cv2.imencode(suffix, image)[1].tobytes()


def encode_rvl(image: np.ndarray) -> bytes:
    """As image_transport's plugin writes it: width, height, and numbers in groups of three bits (Wilson 2017)."""
    numbers, values, previous, place = [], image.ravel().astype(int).tolist(), 0, 0
    while place < len(values):
        for wanted in (False, True):
            start = place
            while place < len(values) and (values[place] > 0) == wanted:
                place += 1
            numbers.append(place - start)
        for value in values[start:place]:
            numbers.append(2 * (value - previous) if value >= previous else 2 * (previous - value) - 1)
            previous = value
    groups = []
    for number in numbers:
        while number > 7:
            groups.append(number & 7 | 8)
            number >>= 3
        groups.append(number)
    groups += [0] * (-len(groups) % 8)
    words = [sum(group << (28 - 4 * place) for place, group in enumerate(groups[start : start + 8])) for start in range(0, len(groups), 8)]
    return struct.pack(f"<ii{len(words)}I", image.shape[1], image.shape[0], *words)


@pytest.mark.parametrize(
    ("form", "suffix", "image"),
    [
        ("jpeg", ".jpg", PHOTO[..., ::-1]),
        ("png", ".png", PHOTO[..., ::-1]),
        ("rgb8; jpeg compressed bgr8", ".jpg", PHOTO[..., ::-1]),
        ("rgb8; png compressed rgb8", ".png", PHOTO),
    ],
)
def test_compressed_colour(form: str, suffix: str, image: np.ndarray) -> None:
    assert np.abs(read_color(compressed(form, encode(image, suffix))).astype(int) - PHOTO).mean() < 6


@pytest.mark.parametrize(
    ("form", "header"), [("16UC1; compressedDepth png", HEADER), ("16UC1; compressedDepth", HEADER), ("16UC1; png compressed ", b"")]
)
def test_compressed_depth_in_millimetres(form: str, header: bytes) -> None:
    assert np.array_equal(read_depth(compressed(form, header + encode(DEPTH_MM))), DEPTH_MM)


def test_depth_in_rvl() -> None:
    depth_mm = DEPTH_MM.copy()
    depth_mm[:2] = depth_mm[5, 7:30] = depth_mm[-1, -3:] = 0
    depth_mm[9, 9] = 65535
    assert np.array_equal(read_depth(compressed("16UC1; compressedDepth rvl", HEADER + encode_rvl(depth_mm))), depth_mm)
    assert not read_depth(compressed("16UC1; compressedDepth rvl", HEADER + encode_rvl(np.zeros_like(DEPTH_MM)))).any()


@pytest.mark.parametrize(("kind", "write"), [("png", encode), ("rvl", encode_rvl)])
def test_compressed_depth_in_metres_is_inverse(kind: str, write) -> None:
    scale, offset = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0  # of the plugin: quantization 100, at most 10 m
    steps = np.rint(scale / (DEPTH_MM / 1000.0) + offset).astype(np.uint16)
    steps[0, 0] = 0
    found = read_depth(compressed(f"32FC1; compressedDepth {kind}", struct.pack("<iff", 0, scale, offset) + write(steps)))
    assert found[0, 0] == 0 and np.abs(found - DEPTH_MM).ravel()[1:].max() < 3


@pytest.mark.parametrize(
    ("read", "form", "content", "reason"),
    [
        (
            read_depth,
            "16UC1; compressedDepth h264",
            HEADER + b"x" * 40,
            "format '16UC1; compressedDepth h264' and 52 bytes without a PNG; expected",
        ),
        (read_depth, "16UC1; compressedDepth rvl", HEADER + b"x" * 4, "4 bytes, too few for a width.*record it again"),
        (read_depth, "16UC1; compressedDepth rvl", HEADER + b"x" * 40, "its header says that it has"),
        (read_depth, "16UC1; compressedDepth rvl", HEADER + encode_rvl(DEPTH_MM)[:-400], "ends (after|within)"),
        (read_depth, "32FC1; compressedDepth png", encode(DEPTH_MM), "no header that says how"),
        (read_depth, "32FC1; compressedDepth png", HEADER + encode(DEPTH_MM), "no header that says how"),
        (read_depth, "16UC1; compressedDepth png", HEADER + encode((DEPTH_MM >> 4).astype(np.uint8)), "other pixels than 16 bits"),
        (read_depth, "16UC1; compressedDepth png", HEADER + encode(PHOTO), "other pixels than 16 bits"),
        (read_color, "16UC1; png compressed ", encode(DEPTH_MM), "which is depth; name the topic of the colour images"),
        (read_color, "32FC1; compressedDepth png", HEADER + encode(DEPTH_MM), "which is depth"),
        (read_color, "jpeg", b"", "0 bytes that are no picture"),
        (read_color, "h264", b"x" * 30, "format 'h264' and 30 bytes that are no picture; expected JPEG"),
    ],
)
def test_what_cannot_be_decoded_is_refused(read, form: str, content: bytes, reason: str) -> None:
    with pytest.raises(StepError, match=reason):
        read(compressed(form, content))


@pytest.mark.parametrize(
    ("encoding", "conversion"),
    [("yuv422", cv2.COLOR_RGB2YUV_UYVY), ("yuv422_yuy2", cv2.COLOR_RGB2YUV_YUY2), ("yuyv", cv2.COLOR_RGB2YUV_YUY2)],
)
def test_yuv_of_webcams(encoding: str, conversion: int) -> None:
    smooth = cv2.GaussianBlur(PHOTO, (0, 0), 3)
    data = cv2.cvtColor(smooth, conversion)
    message = SimpleNamespace(encoding=encoding, height=32, width=48, step=96, is_bigendian=0, data=data.tobytes())
    assert np.abs(read_color(message).astype(int) - smooth).mean() < 6


@pytest.mark.parametrize("rows", ["RG GB", "BG GR", "GB RG", "GR BG"])
def test_bayer_patterns(rows: str) -> None:
    encoding = f"bayer_{rows.replace(' ', '').lower()}8"
    color = {"R": 200, "G": 120, "B": 40}
    tile = np.array([[color[letter] for letter in row] for row in rows.split()], np.uint8)
    message = SimpleNamespace(encoding=encoding, height=32, width=48, step=48, is_bigendian=0, data=np.tile(tile, (16, 24)).tobytes())
    assert read_color(message)[16, 24].tolist() == [200, 120, 40]


def test_rotated_bits_are_found_and_turned_back(capsys: pytest.CaptureFixture[str]) -> None:
    rotated = (DEPTH_MM << 3) | (DEPTH_MM >> 13)
    assert np.array_equal(depth_to_mm(rotated, 1.0, "a.png"), DEPTH_MM)
    assert "a.png: all numbers are multiples of 8, so their bits are rotated" in capsys.readouterr().err
    for raw, step_mm in ((DEPTH_MM, 1.0), (DEPTH_MM * 10, 0.1), (rotated, 0.125), (np.full_like(DEPTH_MM, 800), 1.0)):
        assert np.allclose(depth_to_mm(raw, step_mm, "b.png"), raw * step_mm)
    assert "b.png" not in capsys.readouterr().err
