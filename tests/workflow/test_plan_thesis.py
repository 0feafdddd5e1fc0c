"""What `snakemake thesis` plans with config/thesis.yaml: every row that the thesis published, and no others; and what cannot run."""

import re
from collections import Counter

import pytest

from helpers.paths import REPOSITORY
from helpers.running import planned
from helpers.small_dataset import make_dataset
from zeroshop_steps.report.published.thesis_plan import list_marks, say_costs
from zeroshop_steps.runtime.failures import read_failure

THESIS = ["--configfile", str(REPOSITORY / "config/thesis.yaml")]
ROWS = {
    "4.1": [("2dgs", name, scene) for name in ("vggt_1024", "mast3r") for scene in ("su_l", "su_h", "se")],
    "4.2, upper part": [
        ("svraster", "mast3r", "su_l"),
        *(("svraster", "vggt_1024", scene) for scene in ("su_l", "su_h", "se")),
    ],
    "4.2, lower part": [("2dgs", "vggt_4096", scene) for scene in ("su_l", "su_h", "se")],
}
MARKS = {"4.1": 126, "4.2, upper part": 84, "4.2, lower part": 63}
POSES = ("foundationpose-truth", "foundationpose-cnos", "sam6d_pem-sam6d_ism")
MODELS = ("models", "models_2dgs", "models_svraster", "models_trellis")


def missing(output: str, pattern: str) -> list:
    """What a pattern captures of the files that jobs are planned for."""
    return re.findall(rf"^Reason: Missing output files: (?:\S+, )*?results/thesis/{pattern}[;,\s]", output, re.MULTILINE)


def test_published_marks_are_those_of_the_two_tables():
    found = Counter((cell["nvs"], cell["registration"], cell["scene"]) for cell in list_marks())
    assert found == {row: 21 for rows in ROWS.values() for row in rows}
    assert {table: sum(found[row] for row in rows) for table, rows in ROWS.items()} == MARKS
    assert {cell["object"] for cell in list_marks(["obj_000013"])} == {"obj_000013"}


def test_costs_count_shared_captures_and_registrations_once():
    cells = [
        {"object": "a", "scene": scene, "registration": "mast3r", "nvs": nvs} for scene in ("su_h", "se") for nvs in ("2dgs", "trellis")
    ]
    line = say_costs(cells, 2500, False)
    assert "4 meshes from 2 captures (50 images) and 2 registrations" in line and "2.5 GB of weights" in line


@pytest.mark.slow
def test_the_one_line_plans_exactly_the_published_rows(snakemake):
    run = snakemake("-n", "thesis", *THESIS, "--workflow-profile", str(REPOSITORY / "profiles/gpu"))
    assert run.returncode == 0, run.stdout[-3000:]
    cells = missing(run.stdout, r"ycbv/(obj_\d+)/(\w+)/(\w+)/(\w+)/cell\.csv")
    rows = Counter((nvs, registration, scene) for _, scene, registration, nvs in cells)
    assert {table: sum(rows[row] for row in wanted) for table, wanted in ROWS.items()} == MARKS
    # SVRaster's meshes from MASt3R's cameras in su_h have no marks of their own (4.1.1), but stand in Table 4.5, as Trellis's do.
    models = {("svraster", "mast3r", "su_h"), ("trellis", "mast3r", "su_h")}
    assert set(rows) == models | {row for wanted in ROWS.values() for row in wanted} and set(rows.values()) == {21}
    assert len(cells) == len(set(cells)) == sum(MARKS.values()) + 2 * 21 and sum(MARKS.values()) == 273
    jobs = planned(run.stdout)
    trained = {name: jobs[f"train_{name}"] for name in ("2dgs", "svraster", "trellis")}
    assert trained == {"2dgs": 126 + 63, "svraster": 84 + 21, "trellis": 21} and jobs["align"] == 3 * 21
    assert (jobs["capture_virtual"], jobs["register"], jobs["real_test_set"]) == (3 * 21, 9 * 21, 1) and "test_set" not in jobs
    poses = missing(run.stdout, r"ycbv/bop/(\S+)/poses\.csv")
    assert sorted(poses) == sorted(f"{pair}-{models}" for pair in POSES for models in MODELS)
    found = missing(run.stdout, r"ycbv/bop/(\S+)/detections\.json")
    assert sorted(found) == sorted(f"{name}-{models}" for name in ("cnos", "sam6d_ism") for models in MODELS)
    # With heights as wrong as published, the eight objects of YCB-V whose heights were.
    assert jobs["grasp_attempts"] == 21 * 3 + 8 * 2 and jobs["sightings"] == 5 and jobs["misjudged_models"] == 2
    assert "--scale-percent-of 1=0.96 2=2.01 5=5.79 8=9.19 9=9.57 13=9.28 18=3.16 20=-7.22" in run.stdout
    assert jobs["grasp_table"] == jobs["bop_table"] == jobs["thesis"] == 1
    assert not {"height_by_board", "height_by_mast3r", "stereo", "contour", "weights"} & set(jobs)
    for method, proposals in (("cnos", "fastsam"), ("sam6d_ism", "sam")):
        assert re.search(rf"detect --method {method} .* --proposals {proposals} ", run.stdout)
    said = next(line for line in run.stdout.splitlines() if line.startswith("The thesis: "))
    assert "315 meshes from 63 captures (1470 images) and 189 registrations" in said and "GB of weights" in said
    assert "FastSAM-x.pt" in run.stdout and "films or photos that are not there: mustard_bottle" in run.stdout


@pytest.mark.slow
def test_detectors_and_estimators_are_compared_with_regions_by_sam_and_by_fastsam(snakemake):
    tables = [f"results/thesis/ycbv/tables/{name}.csv" for name in ("detectors", "estimators")]
    run = snakemake("-n", *tables, *THESIS, "--config", "datasets={ycbv: {objects: [obj_000005]}}")
    assert run.returncode == 0, run.stdout[-3000:]
    jobs, models = planned(run.stdout), (*MODELS[:3], "models_without_underside")
    names = [f"{detector}_{network}" for detector in ("cnos", "sam6d_ism") for network in ("sam", "fastsam")]
    found = missing(run.stdout, r"ycbv/bop/(\S+)/detections\.json")
    assert sorted(found) == sorted(f"{name}-{folder}" for name in names for folder in models)
    assert all(jobs[name] == 4 for name in names) and not {"cnos", "sam6d_ism", "train_trellis"} & set(jobs)
    for name in names:
        detector, _, network = name.rpartition("_")
        assert re.search(rf"detect --method {detector} .* --proposals {network} .*/{name}-models/detections\.json", run.stdout)
    poses = missing(run.stdout, r"ycbv/bop/(\S+)/poses\.csv")
    pairs = "foundationpose-cnos_sam", "sam6d_pem-sam6d_ism_sam"
    assert sorted(poses) == sorted(f"{pair}-{folder}" for pair in pairs for folder in models)
    assert jobs["detector_table"] == jobs["estimator_table"] == 1


@pytest.mark.slow
def test_films_that_are_there_get_meshes_and_heights(snakemake, tmp_path):
    (tmp_path / "soap").mkdir()
    (tmp_path / "soap/a.png").touch()
    rows = [("soap", tmp_path / "soap"), ("razors", tmp_path / "absent")]
    lines = [f"photos\t{name}\t{place}\t\t0.1\tknown\t{tmp_path / 'soap'}\n" for name, place in rows]
    (tmp_path / "films.tsv").write_text("dataset\tobject\timages\tmasks\theight_m\theight_method\tmarker_images\n" + "".join(lines))
    few = f"objects_table={tmp_path / 'films.tsv'}", "datasets={ycbv: {objects: [obj_000005]}}"
    run = snakemake("-n", "thesis", *THESIS, "--config", *few)
    assert run.returncode == 0, run.stdout[-3000:]
    jobs = planned(run.stdout)
    assert jobs["cell"] == 13 + 2 + 2 and jobs["height_by_mast3r"] == jobs["height_table"] == jobs["register_photos"] == 1
    assert "results/thesis/photos/soap/video/mast3r/svraster/cell.csv" in run.stdout and "not there: razors" in run.stdout


@pytest.mark.slow
def test_what_lacks_weights_is_a_failed_cell_with_its_reason_and_the_rest_goes_on(snakemake, tmp_path):
    small = "capture={renderer: raycast, image_width_px: 96, image_height_px: 72, views_per_ring: 4}"
    cells = [f"results/thesis/demo/mug/su_h/{place}/cell.csv" for place in ("mast3r/2dgs", "vggt_4096/2dgs", "mast3r/trellis")]
    run = snakemake(*cells, *THESIS, "--config", small, "nvs={2dgs: {train: {device: cpu}}}")
    assert run.returncode == 0, run.stdout
    for cell, step, weights in zip(cells, ("mast3r", "vggt", "mast3r"), ("MASt3R_ViT", "VGGT-1B", "MASt3R_ViT"), strict=True):
        text = (tmp_path / cell).read_text()
        assert f'none,"register.{step}: the weights resources/weights/{weights}' in text and "are not there" in text, text
    # Without that setting, the same is an error before anything runs.
    run = snakemake("-n", cells[0].replace("mug", "bowl"), *THESIS, "--config", "refusals=stop")
    assert run.returncode != 0 and "mast3r cannot run here, it lacks" in run.stdout


def test_a_detector_that_lacks_weights_leaves_scores_that_say_so(snakemake, tmp_path):
    bop = tmp_path / "results/thesis/demo/bop"
    make_dataset(bop)
    (bop / "templates/models/42").mkdir(parents=True)
    run = snakemake(
        "results/thesis/demo/bop/cnos-models/precision.csv",
        *THESIS,
        "--rerun-triggers",
        "mtime",
        "--allowed-rules",
        "cnos",
        "score_detections",
    )
    assert run.returncode == 0, run.stdout
    failure = read_failure(bop / "cnos-models/precision.csv")
    assert failure and failure.step == "detect.cnos" and "FastSAM-x.pt are not there" in failure.reason
