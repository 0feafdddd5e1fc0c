"""The rendered table: a mark for every cell, failures with their reasons, published grades beside ours."""

import pytest

from zeroshop_steps.report.reconstruction import read_cells, read_published_cells, render_page
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import write_table


def rows_of(name: str, scene: str, nvs: str, **figures: object) -> list[dict[str, str]]:
    where = {"dataset": "ycbv", "object": name, "scene": scene, "registration": "colmap", "nvs": nvs}
    reason = str(figures.pop("reason", ""))
    return [
        where | {"measure": measure, "value": str(value), "reason": reason if measure == "grade" else ""}
        for measure, value in figures.items()
    ]


@pytest.fixture
def table(tmp_path):
    rows = rows_of(
        "obj_000001", "su_h", "2dgs", grade="good", grade_by_photos="good", grade_by_truth="good", f_score_1_percent=0.9, accuracy_mm=0.25
    )
    rows += rows_of(
        "obj_000001",
        "se",
        "2dgs",
        grade="sparse",
        grade_by_photos="good",
        grade_by_truth="sparse",
        f_score_1_percent=0.6,
        reason="F too low",
    )
    rows += rows_of(
        "obj_000001", "su_h", "svraster", grade="sparse", grade_by_photos="sparse", grade_by_truth="sparse", f_score_1_percent=0.7
    )
    rows += rows_of("obj_000013", "su_h", "2dgs", grade="good", grade_by_photos="good", grade_by_truth="good", f_score_1_percent=0.8)
    for nvs in ("2dgs", "svraster"):
        rows += rows_of("obj_000013", "se", nvs, grade="none", reason="8 of 30 images registered")
    write_table(tmp_path / "reconstruction.csv", rows)
    return tmp_path / "reconstruction.csv"


def section(text: str, title: str) -> list[str]:
    return text.split(f"## {title}\n\n")[1].split("\n\n##")[0].splitlines()


def test_marks_counts_and_means(table):
    lines = section(render_page(read_cells(table)), "2dgs")
    assert lines == [
        "|  | colmap<br>su_h | colmap<br>se |",
        "| --- | :-: | :-: |",
        "| obj_000001 | ● | ○ |",
        "| obj_000013 | ● | × |",
        "| *good* | 2 | 0 |",
        "| *sparse* | 0 | 1 |",
        "| *none* | 0 | 1 |",
        "| *meshes that means are over* | 2 | 1 |",
        "| *mean F-score at 1 %* | 0.85 | 0.6 |",
        "| *mean accuracy, mm* | 0.25 |  |",
        "| *mean completeness, mm* |  |  |",
        "| *mean training, s* |  |  |",
        "| *mean training, CPU s* |  |  |",
    ]


def test_methods_are_compared_where_all_have_a_mesh(table):
    lines = section(render_page(read_cells(table)), "The methods against each other")
    assert lines[0] == "Over the 1 captures and cameras from which each of them made a mesh."
    assert lines[2] == "|  | 2dgs | svraster |"
    assert "| *mean F-score at 1 %* | 0.9 | 0.7 |" in lines and "| *median F-score at 1 %* | 0.9 | 0.7 |" in lines
    only = read_cells(table).query("nvs == '2dgs'")
    assert len(only) == 4 and "against each other" not in render_page(only)


def test_a_failed_registration_counts_for_every_method_with_its_reason(table):
    text = render_page(read_cells(table))
    assert "| obj_000013 |  | × |" in section(text, "svraster")
    reasons = section(text, "Why cells are not good")
    assert "- × obj_000013, se, colmap, 2dgs and svraster: 8 of 30 images registered" in reasons
    assert "- ○ obj_000001, se, colmap, 2dgs: F too low" in reasons


def test_disagreements_are_shown(table):
    lines = section(render_page(read_cells(table)), "Where photos alone would have judged otherwise")
    assert lines[0] == "3 of 4 cells are judged alike."
    assert lines[2].startswith("- obj_000001, se, colmap, 2dgs: ● by photos (nothing to object); ○ by truth")


def test_published_grades_stand_beside_ours(table):
    lines = section(render_page(read_cells(table), read_published_cells()), "2dgs")
    head = [cell.strip() for cell in lines[0].split("|")]
    assert head.index("colmap<br>se") < head.index("thesis: MASt3R-SfM<br>su_l")
    bowl = [cell.strip() for cell in next(line for line in lines if line.startswith("| obj_000013")).split("|")]
    assert bowl[head.index("thesis: MASt3R-SfM<br>su_h")] == "●" and bowl[head.index("thesis: VGGT (quarter precision)<br>se")] == "×"


def test_the_published_tables_are_whole():
    cells = read_published_cells()
    assert len(cells) == 13 * 21
    assert not cells.duplicated(["nvs", "registration", "scene", "object"]).any()
    assert set(cells.grade) == {"none", "sparse", "good"}


def test_a_cell_without_a_grade_is_named(tmp_path):
    write_table(tmp_path / "table.csv", rows_of("mug", "su_h", "2dgs", accuracy_mm=1.0))
    with pytest.raises(StepError, match="2dgs, colmap, su_h, mug has the grade None"):
        read_cells(tmp_path / "table.csv")
