"""Pixels survive the way through messages in every encoding, and damaged messages are refused with a reason."""

from types import SimpleNamespace

import numpy as np
import pytest

from zeroshop_steps.ros.image_messages import read_color, read_depth, read_mask, write_image
from zeroshop_steps.runtime.errors import StepError

RNG = np.random.default_rng(4)
PHOTO = RNG.integers(0, 256, (5, 7, 3), dtype=np.uint8)


def message(image: np.ndarray, encoding: str, **changes) -> SimpleNamespace:
    made = write_image(SimpleNamespace, image, encoding, SimpleNamespace(frame_id="camera"))
    for name, value in changes.items():
        setattr(made, name, value)
    return made


@pytest.mark.parametrize(
    ("encoding", "image"),
    [
        ("rgb8", PHOTO),
        ("bgr8", PHOTO[..., ::-1]),
        ("8UC3", PHOTO[..., ::-1]),
        ("rgba8", np.dstack([PHOTO, np.full((5, 7), 9, np.uint8)])),
        ("rgb16", PHOTO.astype(np.uint16) << 8),
        ("bgra8", np.dstack([PHOTO[..., ::-1], np.full((5, 7), 9, np.uint8)])),
    ],
)
def test_colours_keep_their_order(encoding, image):
    assert np.array_equal(read_color(message(image, encoding)), PHOTO)


def test_gray_becomes_three_equal_channels():
    assert np.array_equal(read_color(message(PHOTO[..., 0], "mono8")), PHOTO[..., :1].repeat(3, 2))


def test_depth_in_metres_and_in_millimetres_is_the_same():
    depth_m = np.array([[0.5, np.nan, 1.25], [0, -1, np.inf]], np.float32)
    expected = [[500, 0, 1250], [0, 0, 0]]
    assert read_depth(message(depth_m, "32FC1")).tolist() == expected
    assert read_depth(message(np.array(expected, np.uint16), "16UC1")).tolist() == expected


def test_padded_rows_and_big_ends_are_read():
    depth = np.array([[258, 2], [3, 4]], ">u2")
    rows = b"".join(row.tobytes() + b"padding!" for row in depth)
    made = SimpleNamespace(height=2, width=2, encoding="16UC1", is_bigendian=1, step=12, data=rows)
    assert read_depth(made).tolist() == depth.tolist()


def test_without_a_depth_image_there_is_none():
    assert read_depth(SimpleNamespace(height=0, width=0, encoding="", is_bigendian=0, step=0, data=b"")) is None


@pytest.mark.parametrize(("encoding", "kind"), [("mono8", np.uint8), ("8UC1", np.uint8), ("16SC1", np.int16), ("32SC1", np.int32)])
def test_a_mask_is_what_is_not_zero(encoding, kind):
    mask = np.array([[0, 1], [7, 0]], kind)
    assert read_mask(message(mask, encoding), 0).tolist() == [[False, True], [True, False]]


@pytest.mark.parametrize(
    ("read", "made", "reason"),
    [
        (read_color, message(PHOTO, "rgb8", data=b""), "is empty"),
        (read_color, message(PHOTO, "nv12"), "has the encoding 'nv12'; expected rgb8, bgr8"),
        (read_color, message(PHOTO, "rgb8", data=b"12345"), "has 5 bytes in rows of 21"),
        (read_color, message(PHOTO, "rgb8", width=9), "at least 27 bytes a row"),
        (read_color, message(PHOTO, "rgb8", height=0), "7 x 0 px"),
        (read_depth, message(np.zeros((5, 7), np.uint8), "mono8"), "expected 16UC1, mono16, 32FC1"),
        (read_depth, message(np.full((5, 7), 800, np.float32), "32FC1"), "32FC1 is 8e.05 mm in the median.*taken for metres; send metres"),
        (lambda made: read_mask(made, 2), message(PHOTO, "rgb8"), "mask 2 has the encoding 'rgb8'"),
    ],
)
def test_damaged_messages_are_refused(read, made, reason):
    with pytest.raises(StepError, match=reason):
        read(made)
