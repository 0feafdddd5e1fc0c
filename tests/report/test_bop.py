"""The benchmark's table: measured scores with their coordinates, and the page with what was published beside them."""

import csv

import pytest

from zeroshop_steps import methods
from zeroshop_steps.report.bop import read_published, read_scores, render_page
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError


@pytest.fixture
def scores(tmp_path):
    """Detections and poses with true and reconstructed models."""
    values = {
        "contour-models/precision": ("ap", 0.5),
        "render_compare-truth-models/scores": ("ar", 0.9),
        "render_compare-contour-models/scores": ("ar", 0.6),
        "contour-models_2dgs/precision": ("ap", 0.48),
        "render_compare-truth-models_2dgs/scores": ("ar", 0.875),
        "render_compare-contour-models_2dgs/scores": ("ar", 0.61),
    }
    paths = []
    for name, (measure, value) in values.items():
        paths.append(tmp_path / "results/ycbv/bop" / f"{name}.csv")
        paths[-1].parent.mkdir(parents=True)
        paths[-1].write_text(f"measure,object,value\n{measure},,{value}\n{measure},5,0.25\ninstances,,77\n")
    return paths


def test_a_row_a_measurement_and_a_row_of_the_page_for_each_set_of_models(scores, tmp_path):
    out, page = tmp_path / "bop.csv", tmp_path / "bop.md"
    words = ["--method", "bop", "--scores", *map(str, scores), "--root", str(tmp_path / "results"), "--page", str(page), "--out", str(out)]
    assert stage_main("zeroshop_steps.report", words) == 0
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 18 and {row["source"] for row in rows} == {"measured"}
    first = {"dataset": "ycbv", "models": "models", "task": "detection", "method": "contour", "masks": "", "measure": "ap", "object": ""}
    assert rows[0] == first | {"value": "0.5", "source": "measured"}
    lines = page.read_text().splitlines()
    assert lines[2] == "|  | contour<br>AP | render_compare, true masks<br>AR | render_compare, masks by contour<br>AR |"
    assert lines[4:8] == [
        "| ground truth | 0.500 | 0.900 | 0.600 |",
        "| 2dgs | 0.480 | 0.875 | 0.610 |",
        "| *lost with 2dgs* | 0.020 | 0.025 | -0.010 |",
        "",
    ]
    assert stage_main("zeroshop_steps.report", [*words, "--published"]) == 0
    text = page.read_text()
    assert "| ground truth | 0.500 | 0.900 | 0.600 | 0.600 | 0.603 | 0.915 | 0.731 | 0.832 |" in text
    assert "| official submission |  |  |  | 0.599 | 0.605 | 0.882 |  | 0.845 |" in text and "| trellis |  |  |  | 0.567 " in text


def test_the_published_methods_have_their_places():
    rows = read_published()
    assert len(rows) == 24 and set(rows.method) <= {*methods.DETECTORS, *methods.ESTIMATORS}
    assert set(rows.masks) == {"", "truth", "cnos", "sam6d_ism"}
    assert "| *lost with 2dgs* |" in render_page(rows)


def test_what_is_no_run_is_named(tmp_path, scores):
    with pytest.raises(StepError, match="is no run's; expected"):
        read_scores(tmp_path / "results/ycbv/bop/scores.csv", tmp_path / "results")
    scores[0].write_text("")
    with pytest.raises(StepError, match="has no rows"):
        read_scores(scores[0], tmp_path / "results")
    with pytest.raises(StepError, match="run the step that writes it"):
        read_scores(scores[0].with_name("other.csv"), tmp_path / "results")
