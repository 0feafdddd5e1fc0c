"""The table of heights and its plot."""

import csv

import pytest

from zeroshop_steps.report.heights import APART, BESIDE, MAST3R, draw_plot, make_row, read_published_heights
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import write_json


@pytest.fixture
def cells(tmp_path):
    """Three measured cells below a results folder, the last one failed."""
    paths = [
        tmp_path / f"results/ycbv/{name}/colmap/2dgs/height_by_board.json"
        for name in ("obj_000005/su_b", "obj_000005/su_h", "obj_000099/su_h")
    ]
    for path, measured_m in zip(paths, (0.198, 0.191), strict=False):
        write_json(path, {"known_height_m": 0.2, "height_m": measured_m, "height_deviation_m": 0.0015})
    paths[2].parent.mkdir(parents=True)
    write_failure([paths[2]], Failure("height.marker", "the board is cut off"))
    return paths


def test_a_row_a_measurement_with_what_was_published(cells, tmp_path):
    out = tmp_path / "results/ycbv/tables/height.csv"
    words = ["--method", "heights", "--heights", *map(str, cells), "--root", str(tmp_path / "results"), "--out", str(out)]
    assert stage_main("zeroshop_steps.report", words) == 0
    with out.open(newline="") as file:
        beside, apart, failed, *rest = list(csv.DictReader(file))
    assert (beside["how"], apart["how"]) == (BESIDE, APART)
    assert (float(beside["difference_mm"]), float(beside["difference_percent"])) == pytest.approx((-2.0, -1.0))
    assert (float(apart["difference_mm"]), float(apart["difference_percent"])) == pytest.approx((-9.0, -4.5))
    assert float(beside["deviation_mm"]) == 1.5
    assert beside["published_name"] == "mustard_bottle" and float(beside["published_difference_percent"]) == 5.79
    assert failed["height_m"] == "" and failed["reason"] == "height.marker: the board is cut off" and failed["published_name"] == ""
    assert (
        len(rest) == 16 and {row["how"] for row in rest} == {"thesis: MASt3R"} and "toothbrush" in {row["published_name"] for row in rest}
    )
    picture = out.with_suffix(".svg").read_bytes()
    assert b"<svg" in picture and out.with_suffix(".png").read_bytes()[:4] == b"\x89PNG"
    assert stage_main("zeroshop_steps.report", words) == 0
    assert out.with_suffix(".svg").read_bytes() == picture, "same inputs, same bytes"


def test_heights_by_mast3r_of_photos_named_as_the_published_objects_stand_beside_these(tmp_path):
    found = {}
    for place in ("photos/soap/video", "demo/mustard_bottle/su_h"):
        path = tmp_path / f"results/{place}/colmap/2dgs/height_by_mast3r.json"
        write_json(path, {"known_height_m": 0.158, "height_m": 0.15, "height_deviation_m": 0.012})
        found[place] = make_row(path, tmp_path / "results", read_published_heights())
    assert [row["how"] for row in found.values()] == [MAST3R, MAST3R]
    assert found["photos/soap/video"]["published_difference_percent"] == -6.33
    assert found["photos/soap/video"]["difference_percent"] == pytest.approx(-5.063)
    assert "published_name" not in found["demo/mustard_bottle/su_h"], "a model of that name is not the thesis's object"


def test_the_published_heights_are_those_of_both_tables():
    published = read_published_heights()
    assert [sum(row.table == table for row in published) for table in ("4.3", "4.4")] == [8, 9]
    for row in published:
        assert 100 * (row.measured_height_m / row.height_m - 1) == pytest.approx(row.difference_percent, abs=0.5)
    assert [row.ycbv_object for row in published if row.ycbv_object] == [f"obj_{n:06d}" for n in (5, 9, 13, 2, 1, 8, 18, 20)]


def test_the_plot_has_a_point_for_each_measurement(cells, tmp_path):
    rows = [make_row(path, tmp_path / "results", read_published_heights()) for path in cells]
    [axes] = draw_plot(rows, read_published_heights()).axes
    counts = {points.get_label(): len(points.get_offsets()) for points in axes.collections}
    assert counts == {"thesis: MASt3R": 17, BESIDE: 1, APART: 1}


def test_a_measurement_without_truth_does_not_belong_there(cells, tmp_path):
    write_json(cells[0], {"known_height_m": None, "height_m": 0.1, "height_deviation_m": 0.001})
    with pytest.raises(StepError, match="lacks the true"):
        make_row(cells[0], tmp_path / "results", [])
