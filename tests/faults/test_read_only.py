"""Inputs that may only be read, such as those on a camera's card or a shared disk, are inputs like others."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from faults.captures import DISK
from faults.machine import run_alone
from faults.photos import take_photos
from zeroshop_steps.geometry.imaging.images import list_images, write_image


@pytest.mark.skipif(os.geteuid() == 0 and not shutil.which("setpriv"), reason="root may write everywhere, and setpriv is not installed")
def test_photos_and_masks_that_may_only_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = take_photos(tmp_path)
    for photo in photos.iterdir():
        write_image(tmp_path / f"masks/{photo.name}.png", DISK.astype(np.uint8) * 255)
    locked = [photos, tmp_path / "masks"]
    for folder in locked:
        for file in folder.iterdir():
            file.chmod(0o444)
        folder.chmod(0o555)
    try:
        words = ["zeroshop_steps.capture", "--method", "photos", "--images", photos, "--masks", locked[1], "--out", tmp_path / "capture"]
        assert run_alone(words) == 0, capsys.readouterr().err
    finally:
        for folder in locked:
            folder.chmod(0o755)
    assert len(list_images(tmp_path / "capture/masks")) == len(list_images(tmp_path / "capture/images")) == 8
    assert all(file.stat().st_mode & 0o200 for part in ("images", "masks") for file in (tmp_path / "capture" / part).iterdir())
