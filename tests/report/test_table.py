"""The table keeps every measurement with its cell's coordinates, and a failed cell as a row with its reason."""

import csv

import pytest

from zeroshop_steps.report.table import gather
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.tables import write_table


def test_rows_of_all_cells_with_coordinates_and_failures(tmp_path):
    root = tmp_path / "results"
    good = root / "demo/mug/su_h/colmap/2dgs/quality.csv"
    good.parent.mkdir(parents=True)
    good.write_text("measure,value,unit\naccuracy,0.5,mm\nf_score,0.9,\n")
    failed = root / "demo/bowl/su_h/colmap/2dgs/outcome.json"
    passed_on = failed.with_name("grade.csv")
    write_failure([failed, passed_on], Failure("surface.twodgs", "3 of 20 images registered"))
    write_table(tmp_path / "table.csv", gather([good, failed, passed_on], root))
    with (tmp_path / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["object"], row["nvs"], row["measure"], row["value"], row["reason"]) for row in rows] == [
        ("mug", "2dgs", "accuracy", "0.5", ""),
        ("mug", "2dgs", "f_score", "0.9", ""),
        ("bowl", "2dgs", "grade", "none", "surface.twodgs: 3 of 20 images registered"),
    ]
    assert list(rows[0]) == ["dataset", "object", "scene", "registration", "nvs", "measure", "value", "unit", "reason"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("results/a/b/c/d/2dgs/quality.csv", None, "does not exist"),
        ("results/a/b/c/d/2dgs/quality.csv", "measure,value\n", "has no rows"),
        ("elsewhere/quality.csv", "measure,value\nx,1\n", "not below"),
        ("results/a/quality.csv", "measure,value\nx,1\n", "does not lie in a cell"),
    ],
)
def test_bad_files_are_named(tmp_path, name, content, message):
    path = tmp_path / name
    path.parent.mkdir(parents=True)
    if content is not None:
        path.write_text(content)
    with pytest.raises(StepError, match=message) as error:
        gather([path], tmp_path / "results")
    assert str(path) in str(error.value)
