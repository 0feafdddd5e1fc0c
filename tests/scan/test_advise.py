"""The command that says where to look next, of a folder that any program wrote."""

import json
from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.geometry.cameras.viewpoints import look_at
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.scan.recorder import ScanRecorder

BOX = ["--box", "0.6", "0", "0.1", "0.2", "0.2", "0.2"]
POSE = np.linalg.inv(look_at(np.array([0.3, 0.0, 0.3]), np.array([0.6, 0.0, 0.1])))


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """One view, whose depth is a wall through the box."""
    photo = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    lens = Lens("PINHOLE", 160, 120, (150.0, 150.0, 80.0, 60.0))
    ScanRecorder(tmp_path / "scan", "arm").record(photo, np.full((120, 160), 0.35, np.float32), lens, POSE)
    return tmp_path / "scan"


def advise(capture: Path, *words: str) -> int:
    return stage_main(
        "zeroshop_steps.scan", ["--method", "advise", "--capture", str(capture), "--out", str(capture / "advice.json"), *words]
    )


@pytest.mark.parametrize(
    "words", [["--reach-m", "1.2"], ["--arm", "ur10e", "--flange-from-camera", "0.07", "0", "0.03", "0", "0", "0.7071", "0.7071"]]
)
def test_views_are_proposed(capture: Path, words: list[str]) -> None:
    assert advise(capture, *BOX, *words) == 0
    advice = json.loads((capture / "advice.json").read_text())
    assert not advice["enough"] and "1 views" in advice["reason"]
    best = np.array(advice["proposals"][0]["world_from_camera"])
    assert best[0, 3] > 0.6 and best[2, 3] > 0  # the far side


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([*BOX, "--arm", "ur5e"], "needs --flange-from-camera"),
        ([*BOX, "--arm", "ur5e", "--flange-from-camera", *7 * ["0"]], "quaternion of length 0"),
        (["--box", "600", "0", "100", "200", "200", "200"], "metres, not millimetres"),
        ([*BOX, "--least-views", "0"], "--least-views is 0"),
    ],
)
def test_mistakes_are_told(capture: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str) -> None:
    assert advise(capture, *words) == 1
    assert message in capsys.readouterr().err and not (capture / "advice.json").exists()


def test_an_empty_folder_needs_a_first_view(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scan").mkdir()
    assert advise(tmp_path / "scan", *BOX) == 1
    assert "record a first one" in capsys.readouterr().err
