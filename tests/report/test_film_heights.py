"""The heights of films beside the true ones."""

import csv

import pytest

from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import write_json


def test_a_row_a_film_with_its_difference_or_its_reason(tmp_path):
    root = tmp_path / "results"
    cells = [root / "films" / name / "video/colmap/2dgs/height.json" for name in ("mug", "bowl", "cup")]
    truths = [root / "films" / name / "film/truth" for name in ("mug", "bowl", "cup")]
    for truth in truths:
        write_json(truth / "truth.json", {"height_m": 0.1})
    evidence = {"board_seen_in": "the object's photos", "corners": 54}
    write_json(cells[0], {"height_m": 0.102, "height_deviation_m": 0.0005, "evidence": evidence})
    cells[1].parent.mkdir(parents=True)
    write_failure([cells[1]], Failure("register.colmap", "too dark"))
    write_json(cells[2], {"height_m": None, "height_deviation_m": None, "evidence": {}})
    words = ["--method", "film_heights", "--heights", *cells, "--truths", *truths, "--root", root, "--out", tmp_path / "t.csv"]
    assert stage_main("zeroshop_steps.report", [str(word) for word in words]) == 0
    with (tmp_path / "t.csv").open(newline="") as file:
        mug, bowl, cup = csv.DictReader(file)
    assert (mug["object"], mug["nvs"], mug["corners"]) == ("mug", "2dgs", "54")
    assert float(mug["difference_percent"]) == pytest.approx(2.0)
    assert float(mug["difference_mm"]) == pytest.approx(2.0)
    assert "too dark" in bowl["reason"] and bowl["measured_height_m"] == ""
    assert cup["reason"] == "the scale is unknown"
