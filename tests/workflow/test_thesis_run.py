"""The thesis's one line from nothing to its page, in small, without weights: every cell says what it lacks, and the page fills."""

import json

import pandas as pd
import pytest

from helpers.paths import REPOSITORY
from helpers.running import run_snakemake
from helpers.small_dataset import make_dataset

pytestmark = [pytest.mark.faults, pytest.mark.timeout(1800)]
NAMES = ["obj_000001", "obj_000002"]


def test_without_weights_the_run_goes_through_and_every_figure_says_what_it_waits_for(tmp_path):
    make_dataset(tmp_path / "data")
    config = {
        "datasets": {"ycbv": {"models_folder": str(tmp_path / "data/models"), "test_folder": str(tmp_path / "data"), "objects": NAMES}},
        "capture": {"renderer": "raycast", "image_width_px": 96, "image_height_px": 72, "views_per_ring": 4},
        "simulate": {"clear_scenes": 1, "overlapping_scenes": 1, "friction": [0.5]},
        "nvs": {name: {"train": {"device": "cpu"}} for name in ("2dgs", "svraster")},
    }
    (tmp_path / "small.json").write_text(json.dumps(config))
    files = str(REPOSITORY / "config/thesis.yaml"), str(tmp_path / "small.json")
    run = run_snakemake(tmp_path, "thesis", "--configfile", *files, "--keep-going")
    assert run.returncode == 0, run.stdout[-4000:]
    assert "The thesis: " in run.stdout
    page = tmp_path / "results/thesis/ycbv/report/thesis"
    table = pd.read_csv(page / "thesis.csv", dtype=str, na_filter=False)
    marks = table[table.table.isin(["4.1", "4.2"]) & table.column.isin(NAMES)]
    assert len(marks) == 13 * 2 and set(marks.status) == {"differs"} and (marks.ours == "").all()
    assert marks.how.str.contains("failed before it began: .*weights .* are not there").all()
    scores = table[(table.table == "4.5") & (table.status != "quoted")]
    assert len(scores) == 20 and scores.how.str.contains("are not there|no object is left").all(), scores.how.tolist()
    assert (page / "index.html").stat().st_size > 10_000
    assert (tmp_path / "results/thesis/ycbv/tables/grasp.csv").is_file()
