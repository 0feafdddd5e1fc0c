"""Films as phones and browsers write them: HEVC, a varying frame rate, and HDR with ten bits (record_films.py made them)."""

import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest

from zeroshop_steps.capture.video import extract_frames, read_frames, scan_video
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

HERE = Path(__file__).parent
FILMS = HERE / "data/films"
FRAMES, COUNT = 24, 10
SLOW_HDR = pytest.mark.slow  # the decoder takes two seconds to prepare the conversion of the colours


def drawn_frame() -> np.ndarray:
    """The first frame before it was encoded."""
    spec = importlib.util.spec_from_file_location("record_films", HERE / "record_films.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.draw_frames()[0]


@pytest.mark.parametrize("name", ["hevc.mov", "varying.mp4", "varying.webm", pytest.param("hdr_hlg.mkv", marks=SLOW_HDR)])
def test_all_of_the_film_is_used_and_its_frames_are_spread_over_the_way(name, tmp_path, capsys):
    extract_frames(FILMS / name, COUNT, 1920, tmp_path / "capture")
    facts = read_json(tmp_path / "capture/capture.json")
    assert (facts["width_px"], facts["height_px"], facts["video_frames"], facts["images"]) == (160, 120, FRAMES, COUNT)
    # The camera moves evenly from frame to frame, however long each is shown.
    assert facts["source_frames"][0] == 0 and facts["source_frames"][-1] >= 20 and np.diff(facts["source_frames"]).max() <= 4
    assert "damaged" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", ["hevc.mov", "varying.mp4", "varying.webm", *(pytest.param(name, marks=SLOW_HDR) for name in ("hdr_pq.mp4", "hdr_hlg.mkv"))]
)
def test_colours_are_those_that_were_filmed(name):
    """HDR as on an ordinary screen: read as if its values were ordinary ones, they would be off by 36 (PQ) and 19 levels."""
    small = [
        cv2.resize(image, (20, 15), interpolation=cv2.INTER_AREA).astype(float)
        for image in (drawn_frame(), next(read_frames(FILMS / name)))
    ]
    assert small[0].std() > 30.0 and np.abs(small[1] - small[0]).mean() < 12.0


def test_a_film_of_varying_rate_that_was_cut_off_is_refused(tmp_path):
    """Its number of frames is a guess; how much of its duration they cover is none."""
    whole = (FILMS / "varying.webm").read_bytes()
    (tmp_path / "cut.webm").write_bytes(whole[: int(len(whole) * 0.6)])
    with pytest.raises(StepError, match="cut off or damaged"):
        scan_video(tmp_path / "cut.webm")
