"""Plans of a config and a table of photos, without Snakemake."""

from copy import deepcopy

import pytest

from helpers.plan_places import DEFAULTS
from zeroshop_steps.plan.pages import Pages

OF_PASSES = [f"{part}{end}" for part in ("images", "masks", "cameras", "depth") for end in ("", "_2", "_3")]
ROW = dict.fromkeys((*OF_PASSES, "marker_images", "prompt", "scene_of"), "") | {
    **dict.fromkeys(("height_m", "picture_count", "number", "mass_kg"), None),
    "height_method": "",
}


@pytest.fixture
def make_plan(tmp_path, monkeypatch):
    """A plan in an empty folder, with these rows of photos by object and these changes of the parts of the config."""
    monkeypatch.chdir(tmp_path)

    def make(rows=None, say=print, **changes):
        config = deepcopy(DEFAULTS)
        for key, value in changes.items():
            config[key] = {**config[key], **value} if isinstance(value, dict) else value
        return Pages(config, tmp_path, {("photos", name): {**ROW, **row} for name, row in (rows or {}).items()}, say)

    return make
