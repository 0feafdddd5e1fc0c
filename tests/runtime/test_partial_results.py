"""Results that a killed step has kept: taken up where they belong, and only there."""

import pytest

from zeroshop_steps.runtime.partial_results import PartialResults


def write(folder, items, belongs_to, kill=False):
    """Keep some items; what was there before. With `kill`, the loop ends by an error."""
    kept = PartialResults(folder / "poses.csv", belongs_to)
    before = dict(kept.done)
    try:
        with kept:
            for key, value in items.items():
                kept.keep(key, value)
            if kill:
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        pass
    return before


def test_what_a_killed_loop_kept_is_there_again_and_goes_when_it_ends_well(tmp_path):
    (tmp_path / "model.ply").write_text("a")
    place = {"models": tmp_path / "model.ply", "iterations": 5, "masks": None}
    assert write(tmp_path, {"1/0": [0.1, [1, 2]], "1/1": []}, place, kill=True) == {}
    assert write(tmp_path, {"1/2": "c"}, place, kill=True) == {"1/0": [0.1, [1, 2]], "1/1": []}
    assert write(tmp_path, {}, place) == {"1/0": [0.1, [1, 2]], "1/1": [], "1/2": "c"}
    assert write(tmp_path, {}, place) == {} and not list(tmp_path.glob(".*partial"))


@pytest.mark.parametrize("change", ["option", "file", "damage"])
def test_results_of_other_options_or_files_are_not_taken_up(tmp_path, change):
    (tmp_path / "model.ply").write_text("a")
    place = {"models": tmp_path / "model.ply", "iterations": 5}
    write(tmp_path, {"1/0": 1, "1/1": 2}, place, kill=True)
    if change == "option":
        place["iterations"] = 4
    elif change == "file":
        (tmp_path / "model.ply").write_text("another one")
    else:
        path = tmp_path / ".poses.csv.partial"
        path.write_text(path.read_text()[:-3])
    assert write(tmp_path, {}, place) == ({"1/0": 1} if change == "damage" else {})
