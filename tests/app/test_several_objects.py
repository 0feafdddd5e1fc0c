"""Which of several objects in the same photos get a mesh, and what is refused."""

from pathlib import Path

import pytest

from zeroshop_steps.app import several_objects
from zeroshop_steps.app.captures_table import read_captures
from zeroshop_steps.app.reconstruct_object import Request
from zeroshop_steps.app.several_objects import choose_numbers, make_meshes
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json


@pytest.mark.parametrize(
    ("objects", "numbers"), [("all", [1, 2, 3]), ("2", [1, 2]), ("9", [1, 2, 3]), ("3,", [3]), ("3,1", [1, 3]), ("1,1,2", [1, 2])]
)
def test_numbers_are_chosen(objects, numbers):
    assert choose_numbers(objects, 3) == numbers


@pytest.mark.parametrize("objects", ["", "0", "some", "4,", "1;2", "-1"])
def test_what_is_no_choice_is_refused(objects):
    with pytest.raises(StepError, match="--objects is"):
        choose_numbers(objects, 3)


def test_each_object_has_a_row_and_a_run_of_its_own(tmp_path, monkeypatch):
    (tmp_path / "shelf.mp4").touch()
    asked = []

    def run(request, settings, capture, target):
        asked.append((capture.object, target))
        if target.endswith("objects"):
            write_json(tmp_path / "results/photos/shelf" / target / "objects.json", {"objects": [{"number": 1}, {"number": 2}]})
        return capture.object != "shelf_2"

    monkeypatch.setattr(several_objects, "run_for", run)
    monkeypatch.setattr("zeroshop_steps.app.reconstruct_object.provide_weights", lambda: None)
    request = Request([tmp_path / "shelf.mp4"], into=tmp_path, network="none")
    outcomes = list(make_meshes(request, "all"))
    assert [outcome.done for outcome in outcomes] == [True, False]
    assert asked == [("shelf", "video/auto/objects"), ("shelf_1", "2dgs.ply"), ("shelf_2", "2dgs.ply")]
    rows = read_captures(tmp_path)
    assert rows["shelf_2"].scene_of == "shelf" and rows["shelf_2"].number == "2" and rows["shelf_2"].images == rows["shelf"].images


def test_a_height_is_refused_for_several_objects():
    with pytest.raises(StepError, match="printed board"):
        next(make_meshes(Request([Path("shelf")], height_m=0.1), "all"))
