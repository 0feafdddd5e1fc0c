"""One registration after the other: the first that succeeds gives the cameras, and the record says why those before it did not."""

import argparse

import pytest

from zeroshop_steps.register import auto
from zeroshop_steps.register.auto import register
from zeroshop_steps.register.record import RegistrationFailed


def succeed(folder):
    (folder / "images").mkdir()
    (folder / "images" / "0.png").touch()
    return {"method": "found", "registered": 20}


def fail(registered):
    def attempt(folder):
        (folder / "images").mkdir()
        raise RegistrationFailed(f"{registered} of 20 images registered", {"registered": registered})

    return attempt


@pytest.fixture
def out(tmp_path):
    (tmp_path / "cameras").mkdir()
    return tmp_path / "cameras"


def test_what_succeeds_first_is_kept_and_nothing_else_runs(out):
    record = register(out, {"colmap": succeed, "aliked": fail(0)})
    assert record == {"method": "found", "registered": 20, "tried": {}}
    assert [path.name for path in out.rglob("*.png")] == ["0.png"] and [path.name for path in out.parent.iterdir()] == ["cameras"]


def test_the_next_is_tried_and_the_record_says_why(out):
    record = register(out, {"colmap": fail(3), "aliked": succeed})
    assert record["method"] == "found" and record["tried"]["colmap"]["reason"] == "3 of 20 images registered"
    assert record["tried"]["colmap"]["seconds"] >= 0 and (out / "images/0.png").is_file()


def test_where_all_fail_both_reasons_are_told_and_nothing_is_left(out):
    with pytest.raises(RegistrationFailed, match="by colmap: 3 of 20 .*; by aliked: 5 of 20") as error:
        register(out, {"colmap": fail(3), "aliked": fail(5)})
    assert error.value.figures["registered"] == 5 and set(error.value.figures["tried"]) == {"colmap", "aliked"}
    assert not list(out.iterdir())


def test_without_weights_the_reason_says_how_to_get_them(blank_capture, tmp_path):
    parser = argparse.ArgumentParser()
    auto.add_arguments(parser)
    words = ["--capture", blank_capture, "--scene", "su_l", "--out", tmp_path / "cameras", "--weights", tmp_path / "nowhere"]
    with pytest.raises(RegistrationFailed) as error:
        auto.run(parser.parse_args(list(map(str, words))))
    for part in (
        "0 of 10 images registered",
        "snakemake resources/weights/aliked/{aliked-n16.pth,aliked_lightglue.pth}",
        "50 MB",
        "Apache-2.0",
    ):
        assert part in str(error.value)
