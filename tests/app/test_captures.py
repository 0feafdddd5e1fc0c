"""The table behind `zeroshop`: one name, one input; the workflow reads it as a table of objects."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from zeroshop_steps import methods
from zeroshop_steps.app.captures_table import TABLE, Capture, add_capture, make_name, read_captures
from zeroshop_steps.runtime.config_files import read_objects
from zeroshop_steps.runtime.errors import StepError

SCHEMA = Path(__file__).resolve().parents[2] / "workflow/schemas/objects.schema.yaml"


@pytest.mark.parametrize(
    ("source", "name"), [("Mug (new).MOV", "Mug_new"), ("a.b.mp4", "a_b"), ("_x_.mp4", "x"), ("tasse ö 3.mp4", "tasse_3")]
)
def test_a_name_is_made_safe(tmp_path, source, name):
    (tmp_path / source).touch()
    assert make_name(tmp_path / source) == name


def test_names_of_the_workflow_and_names_without_letters_are_refused(tmp_path):
    for source in ("report", "..."):
        with pytest.raises(StepError, match="--name"):
            make_name(tmp_path / source)


def test_the_workflow_reads_the_table(tmp_path):
    add_capture(tmp_path, Capture("mug", "/films/mug.mp4", height_m="0.096", height_method="known"))
    add_capture(tmp_path, Capture("box", "/photos/my box", masks="/masks"))
    rows = read_objects(tmp_path / TABLE, SCHEMA, methods.HEIGHTS)
    assert rows["photos", "mug"]["height_m"] == 0.096 and rows["photos", "box"]["images"] == "/photos/my box"
    assert rows["photos", "box"]["height_m"] is None


def test_what_is_given_again_replaces_and_what_is_left_out_stays(tmp_path):
    add_capture(tmp_path, Capture("mug", "/films/mug.mp4", masks="/masks"))
    row = add_capture(tmp_path, Capture("mug", "/films/mug.mp4", height_m="0.1", height_method="known"))
    assert row.masks == "/masks" and row.height_m == "0.1"
    assert read_captures(tmp_path) == {"mug": row}


def test_a_name_of_another_input_is_refused(tmp_path):
    add_capture(tmp_path, Capture("mug", "/films/mug.mp4"))
    with pytest.raises(StepError, match="belongs to /films/mug.mp4"):
        add_capture(tmp_path, Capture("mug", "/other/mug.mp4"))
    (tmp_path / "results/photos/box").mkdir()
    with pytest.raises(StepError, match="another table"):
        add_capture(tmp_path, Capture("box", "/films/box.mp4"))
    assert set(read_captures(tmp_path)) == {"mug"}


def test_a_damaged_table_is_named(tmp_path):
    (tmp_path / TABLE).parent.mkdir(parents=True)
    (tmp_path / TABLE).write_text("nothing\there\n1\n")
    with pytest.raises(StepError, match="captures.tsv is not the table"):
        read_captures(tmp_path)


def test_runs_that_begin_together_all_find_their_rows(tmp_path):
    names = [f"mug_{number}" for number in range(24)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda name: add_capture(tmp_path, Capture(name, f"/films/{name}.mp4")), names))
    assert sorted(read_captures(tmp_path)) == sorted(names)
