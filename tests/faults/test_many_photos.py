"""A folder of 300 photos is judged and reduced to the most useful ones in bounded time, and both say so."""

import time
from pathlib import Path

import pytest

from faults.photos import take_photos
from helpers.faults import step
from zeroshop_steps.app.command import main
from zeroshop_steps.geometry.imaging.images import list_images

pytestmark = [pytest.mark.faults, pytest.mark.slow]

MOST_CPU_S = 120.0
"""On any machine of today: it takes 10 to 60 s, by how many features the photos have."""


def test_three_hundred_photos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = take_photos(tmp_path, 320, 240, 300)
    start_s = time.process_time()
    assert main(["check", str(photos)]) == 0
    assert "300 pictures; the 60 most useful ones are taken (photos.most_images)" in capsys.readouterr().out
    assert step("capture", "photos", images=photos, out=tmp_path / "capture") == 0
    assert "240 of 300 photos that show what sharper ones show" in capsys.readouterr().err
    assert len(list_images(tmp_path / "capture/images")) == 60
    assert time.process_time() - start_s < MOST_CPU_S
