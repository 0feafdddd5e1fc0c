"""Options of steps in the config beside the keys that it describes."""

from copy import deepcopy
from pathlib import Path

import pytest

from zeroshop_steps import methods
from zeroshop_steps.plan import step_options
from zeroshop_steps.plan.step_options import check_step_options, complete_sections
from zeroshop_steps.runtime.config_files import check_config, read_config_schema, read_yaml
from zeroshop_steps.runtime.errors import StepError

REPOSITORY = Path(__file__).parents[2]
SCHEMA = read_config_schema(REPOSITORY / "workflow/schemas/config.schema.yaml", methods.CHOICES, methods.SECTIONS)
DEFAULTS = read_yaml(REPOSITORY / "config/config.yaml")


def change(**changes):
    """The defaults with these changes, as deep as mappings go."""

    def merge(below, other):
        return {**below, **{key: merge(below.get(key) or {}, value) if isinstance(value, dict) else value for key, value in other.items()}}

    return merge(deepcopy(DEFAULTS), changes)


def check(**changes):
    config = change(**changes)
    check_config(config, SCHEMA)
    check_step_options(complete_sections(config), SCHEMA)


def test_the_defaults_and_those_of_the_thesis_are_known():
    check()
    check(**read_yaml(REPOSITORY / "config/thesis.yaml"))


def test_any_option_of_a_step_may_stand_in_its_section():
    check(
        register={"colmap": {"min_share": 0.5}, "vggt_1024": {"query_views": 3}, "da3": {"refine": "none"}},
        nvs={"2dgs": {"train": {"lambda_dssim": 0.1}}, "svraster": {"mesh": {"image_width_px": 300}}},
        capture={"elevations_deg": [10, 20]},
        pose={"foundationpose": {"iterations": 3}},
        report={"page": {"faces": 500}},
    )


def test_plans_ask_a_step_only_for_options_that_the_schema_does_not_describe(monkeypatch):
    """Of a plan that asks, most of the time is the import of the step's libraries."""
    asked = []
    read = step_options._read_options
    monkeypatch.setattr(step_options, "_read_options", lambda step: asked.append(step) or read(step))
    check_step_options(DEFAULTS, SCHEMA)
    assert not asked
    check_step_options(change(grasp={"samples": 300}), SCHEMA)
    assert asked == ["grasp.antipodal"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"nvs": {"2dgs": {"train": {"lambda_sim": 0.1}}}}, r"option of nvs\.2dgs\.train: lambda_sim\. Did you mean lambda_dssim"),
        ({"nvs": {"2dgs": {"train": {"lambda_dssim": "much"}}}}, r"nvs\.2dgs\.train\.lambda_dssim: 'much' is no float"),
        ({"register": {"da3": {"refine": "often"}}}, r"register\.da3\.refine: 'often' is none of matches, none"),
        ({"capture": {"elevations_deg": {"se": [0]}}}, r"capture\.elevations_deg: .* is no float"),
        ({"grasp": {"sample": 3}}, r"option of grasp: sample\. Did you mean samples"),
        ({"finish": {"device": "cuda"}}, r"finish\.device is devices\.kernels now"),
        ({"simulate": {"mass_kg": {}}}, r"simulate\.mass_kg is assets\.masses_kg, by dataset and object now"),
    ],
)
def test_an_option_that_no_step_knows_or_takes_is_refused(changes, said):
    with pytest.raises(StepError, match=said):
        check(**changes)


def test_what_the_config_says_once_reaches_every_section_that_says_nothing_else():
    full = complete_sections(change(devices={"networks": "cpu", "kernels": "cuda"}, nvs={"svraster": {"train": {"device": "auto"}}}))
    assert full["detect"]["cnos"]["device"] == full["register"]["auto"]["device"] == full["nvs"]["trellis"]["device"] == "cpu"
    assert full["nvs"]["2dgs"]["train"]["device"] == full["stereo"]["device"] == full["finish"]["device"] == "cuda"
    assert full["nvs"]["svraster"]["train"]["device"] == "auto" and "device" not in full["register"]["colmap"]
    assert complete_sections(DEFAULTS)["grasp"]["unknown_scale"] == "refuse"


def test_presets_have_defaults_of_their_own():
    assert complete_sections(DEFAULTS)["register"]["vggt_1024"]["query_views"] == 30
    assert complete_sections(change(register={"vggt_1024": {"query_views": 3}}))["register"]["vggt_1024"]["query_views"] == 3
