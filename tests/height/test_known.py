"""Heights that are known, and scales that stay unknown."""

import numpy as np
import pytest
import yaml

from helpers.paths import REPOSITORY
from zeroshop_steps.capture.known_height import HEIGHT_RANGE_M, read_known_height_m
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json


@pytest.fixture
def height(carton, tmp_path):
    """Run a method on the carton (0.09 m high) with this known height; gives the exit status and the record."""

    def run(method, known):
        write_ply(tmp_path / "clean.ply", carton.mesh)
        write_json(tmp_path / "capture" / "capture.json", {"known_height_m": known})
        words = ["--method", method, "--mesh", tmp_path / "clean.ply", "--cameras", carton.cameras, "--capture", tmp_path / "capture"]
        status = stage_main("zeroshop_steps.height", [str(word) for word in [*words, "--out", tmp_path / "height.json"]])
        return status, read_json(tmp_path / "height.json") if status == 0 else None

    return run


@pytest.mark.parametrize("height_m", [0.027, 0.09, 0.22])
def test_a_known_height_gives_the_exact_scale(height, height_m):
    _, record = height("known", height_m)
    assert (record["scale"], record["scale_source"], record["up_source"]) == ("known", "known_height", "support_plane")
    assert record["height_m"] == pytest.approx(height_m, rel=1e-12)
    assert record["metres_per_unit"] * record["height_in_registration"] == pytest.approx(height_m, rel=1e-12)
    # The carton's unit is the millimetre.
    assert record["metres_per_unit"] == pytest.approx(height_m / 90.0, rel=2e-3)
    assert record["top"] - record["bottom"] == record["height_in_registration"]
    assert np.array(record["up"]) == pytest.approx([0, 0, 1], abs=1e-3)
    assert 0.0005 <= record["height_deviation_m"] < 0.003


def test_without_a_height_the_scale_is_unknown_and_that_is_said(height, capsys):
    status, record = height("none", None)
    assert status == 0 and record["scale"] == record["scale_source"] == "unknown"
    assert record["height_m"] is None and record["metres_per_unit"] is None
    message = capsys.readouterr().err
    assert "warning: the scale is unknown" in message and "height_m" in message


def test_a_known_height_that_is_missing_is_an_error(height, capsys):
    assert height("known", None)[0] == 1
    message = capsys.readouterr().err
    assert "no height is given" in message and "known_height_m" in message


@pytest.mark.parametrize("absurd", [-1.0, 0.0, 50.0, "tall"])
def test_absurd_heights_are_refused(tmp_path, absurd):
    write_json(tmp_path / "capture.json", {"known_height_m": absurd})
    with pytest.raises(StepError, match="capture.json: known_height_m is"):
        read_known_height_m(tmp_path / "capture.json")


@pytest.mark.parametrize("height_m", [-0.1, 0.0, 190.0, 3.5, float("nan"), float("inf")])
def test_absurd_heights_of_the_user_are_refused(tmp_path, height_m):
    with pytest.raises(StepError) as error:
        read_known_height_m(tmp_path / "capture.json", height_m)
    assert f"height {height_m:g} m is out of range" in str(error.value) and "0.005 to 3" in str(error.value)


def test_both_bounds_of_a_given_height_are_those_of_the_table():
    schema = yaml.safe_load((REPOSITORY / "workflow/schemas/objects.schema.yaml").read_text())
    assert tuple(schema["properties"]["height_m"][bound] for bound in ("minimum", "maximum")) == HEIGHT_RANGE_M


def test_the_height_that_the_user_gives_goes_before_that_of_the_capture(tmp_path):
    write_json(tmp_path / "capture.json", {"known_height_m": 0.2})
    assert read_known_height_m(tmp_path / "capture.json") == 0.2
    assert read_known_height_m(tmp_path / "capture.json", 0.1) == 0.1
