"""A method that cannot run here is left out of "all" and refused where it is named, with what it lacks."""

import pytest
import yaml

from helpers.paths import REPOSITORY
from zeroshop_steps import methods
from zeroshop_steps.methods import Method, lacks, left_out, refusal


def test_a_method_without_needs_can_run():
    assert lacks(methods.REGISTRATIONS["colmap"]) == [] and lacks(methods.NVS["2dgs"]) == []
    assert refusal("registration", "truth", methods.REGISTRATIONS) is None


def test_what_is_missing_is_named(tmp_path):
    learned = Method("register.colmap", weights=("a.pth", "b.pth", "c.pth"))
    (tmp_path / "resources/weights").mkdir(parents=True)
    (tmp_path / "resources/weights/b.pth").touch()
    assert lacks(learned, tmp_path) == ["the weights resources/weights/a.pth", "the weights resources/weights/c.pth"]
    table = {"colmap": Method("register.colmap"), "learned": learned, "later": Method("register.no_such_step")}
    assert refusal("registration", "learned", table, tmp_path) == (
        "registration learned cannot run here, it lacks the weights resources/weights/a.pth and the weights resources/weights/c.pth."
        " Those that can: colmap."
    )
    assert "no_such_step, which this version does not have" in refusal("registration", "later", table, tmp_path)
    line = left_out(table, root=tmp_path)
    assert line.startswith("Left out of tables: learned lacks the weights") and "; later lacks" in line and "\n" not in line
    (tmp_path / "resources/weights/a.pth").touch()
    (tmp_path / "resources/weights/c.pth").touch()
    assert lacks(learned, tmp_path) == []
    assert left_out({"learned": learned}, root=tmp_path) is None


def test_the_table_of_photos_may_name_every_height_method():
    schema = yaml.safe_load((REPOSITORY / "workflow/schemas/objects.schema.yaml").read_text())
    assert sorted(schema["properties"]["height_method"]["enum"]) == sorted(["", *methods.HEIGHTS])


@pytest.mark.parametrize(
    ("table", "key"),
    [
        (methods.REGISTRATIONS, "virtual_registration"),
        (methods.NVS, "nvs_method"),
        (methods.DETECTORS, "detector"),
        (methods.ESTIMATORS, "estimator"),
    ],
)
def test_the_config_may_name_every_method(table, key):
    schema = yaml.safe_load((REPOSITORY / "workflow/schemas/config.schema.yaml").read_text())
    assert schema["$defs"][key]["enum"] == list(table)
