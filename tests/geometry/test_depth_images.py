"""Depth from OpenEXR files."""

import numpy as np
import OpenEXR
import pytest

from zeroshop_steps.geometry.imaging.depth_images import read_exr
from zeroshop_steps.runtime.errors import StepError

DEPTH_M = np.random.default_rng(0).uniform(0.3, 2.0, (10, 12)).astype(np.float32)


def write_exr(path, channels) -> None:
    OpenEXR.File({"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}, channels).write(str(path))


@pytest.mark.parametrize(
    "channels",
    [
        {"Z": DEPTH_M},
        {"Depth.V": DEPTH_M, "R": DEPTH_M * 2, "G": DEPTH_M, "B": DEPTH_M},
        {"RGB": np.repeat(DEPTH_M[..., None], 3, 2)},
        {"anything": DEPTH_M},
    ],
    ids=["Z", "Blender", "grey", "single"],
)
def test_the_depth_of_an_exr_is_found(channels, tmp_path):
    write_exr(tmp_path / "depth.exr", channels)
    assert np.array_equal(read_exr(tmp_path / "depth.exr"), DEPTH_M)


def test_an_exr_that_is_no_depth_is_refused(tmp_path):
    write_exr(tmp_path / "color.exr", {"RGB": np.random.default_rng(1).random((10, 12, 3), np.float32)})
    with pytest.raises(StepError, match=r"color\.exr has the channels B, G, R; expected one, or one called Z or V"):
        read_exr(tmp_path / "color.exr")
    (tmp_path / "cut.exr").write_bytes((tmp_path / "color.exr").read_bytes()[:100])
    with pytest.raises(StepError, match=r"cut\.exr cannot be read as OpenEXR"):
        read_exr(tmp_path / "cut.exr")
