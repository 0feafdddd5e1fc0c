"""The page of the thesis: beside a published figure stands only the same one; all others stand apart, with what differs."""

import json

import pandas as pd
import pytest

from helpers.paths import REPOSITORY
from zeroshop_steps.report.thesis import compare, count_good
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import write_json

CAPTURE = {"renderer": "blenderproc", "samples": 16, "width_px": 2000, "height_px": 1500}
VIEWS = {"su_l": 20, "su_h": 20, "se": 30}
PARAMETERS = {
    "mast3r": {"min_track": 5},
    "vggt_1024": {"refine": "tracks", "tracked_points": 1024, "lens": "SIMPLE_PINHOLE", "max_error_px": 8.0},
}
TRAINING = {
    "iterations": 30_000,
    "sh_degree": 3,
    "lambda_dssim": 0.2,
    "lambda_normal": 0.05,
    "lambda_distortion": 0.0,
    "initialization": "sparse",
}
TOOK = {"test_folder": "download", "scene": "su_h", "registration": "mast3r", "pose": {"foundationpose": {"iterations": 5}}}
DETECTED = {"cnos": {"proposals": "fastsam", "describer": "dinov2-large"}}


def make_page(folder, *options):
    """Run the command; the rows of both CSVs, and the page."""
    out = folder / "page"
    words = ["--table", out / "thesis.csv", "--other-table", out / "other.csv", "--out", out / "index.html", *options]
    assert stage_main("zeroshop_steps.report", ["--method", "thesis", *map(str, words)]) == 0
    tables = [pd.read_csv(out / name, dtype=str, na_filter=False) for name in ("thesis.csv", "other.csv")]
    return *tables, (out / "index.html").read_text()


def write_cell(root, place, grade, capture=(), training=(), parameters=(), failed=False):
    """A cell as the thesis's regime makes it, but for these changes; or one whose registration failed before it began."""
    cell = root / "ycbv" / place
    scene, registration = place.split("/")[1:3]
    write_json(cell.parents[1] / "capture/capture.json", CAPTURE | {"images": VIEWS[scene]} | dict(capture))
    if failed:
        write_failure([f"{cell.parent}/cameras/", cell / "outcome.json"], Failure("register.mast3r", "the weights are not there"))
        return
    found = PARAMETERS.get(registration, {}) | dict(parameters)
    write_json(cell.parent / "cameras/registration.json", {"method": registration, "parameters": found})
    write_json(cell / "splats/training.json", {"settings": TRAINING | dict(training), "image_width_px": 400})
    write_json(cell / "grade.json", {"grade": grade})
    (cell / "mesh.ply").write_text("ply")


def test_without_results_no_published_figure_has_one_of_ours_beside_it(tmp_path):
    table, other, page = make_page(tmp_path, "--recorded", REPOSITORY / "docs")
    sizes = {"4.1": 126, "4.2": 84 + 63, "4.3": 8, "4.4": 9, "4.5": 24, "4.6": 8}
    published = table[table.column != ""]
    assert published.groupby("table").size().to_dict() == sizes and not table.duplicated(["table", "row", "column"]).any()
    assert published.groupby("status").size().to_dict() == {"waiting": 318, "quoted": 4} and (published.ours == "").all()
    full = table[table.row.str.contains("full precision")]
    assert set(full.how) == {"weights, a GPU"} and set(table[table.table == "4.6"].how) == {"a robot"}
    assert set(table[table.table == "4.4"].how) == {"the thesis's own films"}
    assert "Figures of another kind" in page and "They stand for none of the published figures" in page
    # One column of ours stands once, not in the rows of three registrations.
    marks = other[other.kind == "marks"]
    assert len(marks) == 252 and not marks.duplicated(["row", "column"]).any() and "2dgs, COLMAP, su_h" in set(marks.row)
    gelatin = other[other.row.str.startswith("obj_000008")].iloc[0]
    assert "another pose" in gelatin.differs and "a scale of known size" in gelatin.differs and "rendered images" in gelatin.differs
    scores = other[other.kind == "scores"]
    assert set(scores.column.str.partition(",")[0]) == {"contour", "render_compare"}
    assert scores.differs.str.contains("74 instances in rendered images").all()


def test_nothing_at_all_waits_for_what_it_lacks(tmp_path):
    table, other, _ = make_page(tmp_path)
    assert set(table.status) == {"waiting", "quoted"} and (table.ours == "").all() and other.empty


@pytest.mark.parametrize(
    ("place", "changes", "differs"),
    [
        ("obj_000001/su_h/mast3r/2dgs", {}, ""),
        ("obj_000001/su_h/mast3r/2dgs", {"capture": {"renderer": "raycast"}}, "images: renderer raycast (published: blenderproc)"),
        ("obj_000001/se/mast3r/2dgs", {"capture": {"images": 20}}, "20 images (published: 30)"),
        ("obj_000001/su_h/mast3r/2dgs", {"training": {"iterations": 800}}, "training: iterations 800 (published: 30000)"),
        ("obj_000001/su_h/mast3r/2dgs", {"parameters": {"min_track": 2}}, "registration: min track 2 (published: 5)"),
        ("obj_000001/su_h/vggt_1024/2dgs", {}, "tracks by VGGT's own head"),
        ("obj_000001/su_h/mast3r/2dgs", {"failed": True}, "failed before it began"),
    ],
)
def test_a_mark_is_reproduced_only_where_nothing_differs(tmp_path, place, changes, differs):
    write_cell(tmp_path / "results/thesis", place, "sparse", **changes)
    write_cell(tmp_path / "results", "obj_000002/su_h/colmap/2dgs", "good")
    table, other, page = make_page(tmp_path, "--results", tmp_path / "results", tmp_path / "results/thesis")
    row = table[(table.column == "obj_000001") & (table.regime != "") | table.how.str.contains("before it began")]
    assert len(row) == 1 and row.iloc[0].status == ("differs" if differs else "reproduced")
    assert row.iloc[0].ours == ("" if differs else "sparse") and differs in row.iloc[0].how
    apart = other[other.column == "obj_000001"]
    assert len(apart) == bool(differs) and differs in "".join(apart.differs) and differs.replace("'", "&#39;") in page
    assert other[other.column == "obj_000002"].differs.str.contains("cameras by").all()


@pytest.mark.parametrize(
    ("made", "scene", "instances", "differs"),
    [
        ({**TOOK, "detect": DETECTED}, "su_h", 4123, ""),
        ({**TOOK, "detect": DETECTED, "test_folder": None}, "su_h", 4123, "4123 instances in rendered images"),
        ({**TOOK, "detect": DETECTED}, "su_h", 74, "74 instances (published: about 4,100"),
        ({**TOOK, "detect": {"cnos": DETECTED["cnos"] | {"proposals": "sam"}}}, "su_h", 4123, "cnos: proposals sam (published: fastsam)"),
        ({**TOOK, "detect": DETECTED, "registration": "colmap"}, "su_h", 4123, "models: registration colmap (published: mast3r)"),
        ({**TOOK, "detect": DETECTED}, "se", 4123, "cells not recorded"),
        ({}, "su_h", 4123, "not recorded (published: fastsam)"),
    ],
)
def test_scores_are_reproduced_only_from_the_same_images_regions_and_models(tmp_path, made, scene, instances, differs):
    rows = [
        ("detection", "cnos", "", "ap", "0.5"),
        ("detection", "cnos", "", "instances", instances),
        ("pose", "render_compare", "truth", "ar", "0.9"),
    ]
    columns = ["task", "method", "masks", "measure", "value"]
    table = pd.DataFrame(rows, columns=columns).assign(models="models_2dgs", dataset="ycbv", object="", source="measured")
    root = tmp_path / "results/thesis"
    (root / "ycbv/tables").mkdir(parents=True)
    table.to_csv(root / "ycbv/tables/bop.csv", index=False)
    (root / "ycbv/tables/bop.json").write_text(json.dumps(made))
    write_json(root / "ycbv/bop/models_2dgs/models_info.json", {str(number): {} for number in range(1, 22)})
    for number in range(1, 22):
        write_cell(root, f"obj_{number:06d}/{scene}/mast3r/2dgs", "good")
    found, other, _ = make_page(tmp_path, "--results", root)
    found = found[(found.table == "4.5") & (found.row == "2dgs")].set_index("column")
    own = found.loc["cnos, AP"]
    assert own.status == ("differs" if differs else "reproduced") and own.ours == ("" if differs else "0.500") and differs in own.how
    assert found.loc["foundationpose, masks: truth, AR", "status"] == "waiting"
    assert set(other[other.kind == "scores"].column) == {"render_compare, masks: truth, AR"} | ({"cnos, AP"} if differs else set())


def test_a_run_that_failed_says_why_in_its_place(tmp_path):
    row = {"dataset": "ycbv", "models": "models", "task": "detection", "method": "cnos", "masks": "", "object": "", "source": "measured"}
    (tmp_path / "results/ycbv/tables").mkdir(parents=True)
    pd.DataFrame([row | {"measure": "failed", "value": "FastSAM-x.pt is not there"}]).to_csv(
        tmp_path / "results/ycbv/tables/bop.csv", index=False
    )
    table, other, _ = make_page(tmp_path, "--results", tmp_path / "results")
    own = table[(table.row == "ground truth") & (table.column == "cnos, AP")].iloc[0]
    assert (own.status, own.how) == ("waiting", "FastSAM-x.pt is not there") and other.empty


def test_films_fill_their_statement_and_heights_say_how_they_are_measured(tmp_path):
    for name, done in (("soap", ("2dgs", "svraster")), ("razors", ("2dgs",)), ("cup", ("2dgs",))):
        for nvs in ("2dgs", "svraster"):
            cell = tmp_path / "results/photos" / name / "video/mast3r" / nvs
            write_json(cell / "grade.json", {"grade": "good"})
            if nvs in done:
                (cell / "mesh.ply").write_text("ply")
            else:
                write_failure([cell / "outcome.json"], Failure("surface.svraster", "left 3 disks"))
    columns = {"registration": "mast3r", "nvs": "2dgs", "how": "MASt3R", "height_m": "0.16", "measured_height_m": "0.168"}
    rows = pd.DataFrame([{"dataset": "photos", "object": "soap", "difference_percent": "5"} | columns])
    (tmp_path / "results/photos/tables").mkdir()
    rows.to_csv(tmp_path / "results/photos/tables/height.csv", index=False)
    table, other, _ = make_page(tmp_path, "--results", tmp_path / "results")
    statement = table[table.row.str.startswith("All filmed real objects")].iloc[0]
    assert statement.ours == "1 of 2 filmed objects have meshes by both; not razors"
    soap = table[table.row == "soap"].iloc[0]
    assert soap.status == "differs" and soap.how.startswith("metres per unit") and soap.ours == ""
    assert other[other.kind == "heights"].ours.tolist() == ["5"]


def test_comparisons_of_detectors_and_estimators_stand_beside_what_the_thesis_says_of_them(tmp_path):
    columns = ["models", "task", "method", "masks", "measure", "value"]
    rows = [("models", "detection", "cnos_sam", "", "ap", "0.6"), ("models", "detection", "cnos_fastsam", "", "failed", "no weights")]
    rows += [("models_without_underside", "detection", "cnos_sam", "", "ap", "0.25")]
    table = pd.DataFrame(rows, columns=columns).assign(dataset="ycbv", object="", source="measured")
    (tmp_path / "results/ycbv/tables").mkdir(parents=True)
    table.to_csv(tmp_path / "results/ycbv/tables/detectors.csv", index=False)
    found = make_page(tmp_path, "--results", tmp_path / "results")[0].set_index("row")
    said = found.loc["CNOS with SAM segments best; FastSAM fails for flipped objects without an underside"]
    assert said.ours.endswith("ground truth: cnos_sam 0.600; without underside: cnos_sam 0.250") and said.status == "differs"
    other = "SAM-6D gets worse with these meshes, and is unusable for inverted objects"
    assert (found.loc[other, "ours"], found.loc[other, "status"]) == ("", "waiting")


def test_a_rehearsal_fills_every_place_and_marks_each_of_its_figures(tmp_path):
    write_cell(tmp_path / "results/thesis", "obj_000001/su_h/mast3r/2dgs", "sparse", training={"iterations": 60})
    write_cell(tmp_path / "results/thesis", "obj_000002/su_h/mast3r/2dgs", "good")
    table, _, page = make_page(tmp_path, "--results", tmp_path / "results/thesis", "--rehearsal")
    own = table[table.source != ""].set_index("column")
    assert own.ours.to_dict() == {"obj_000001": "sparse", "obj_000002": "good"} and set(own.status) == {"rehearsed"}
    assert set(own.regime) == {"rehearsal"}
    assert own.loc["obj_000001", "how"] == "training: iterations 60 (published: 30000)" and own.loc["obj_000002", "how"] == ""
    assert "This is a rehearsal." in page and "<em>– ours: 2 rehearsed, 19 waiting for" in page and "1 of 2" in page
    assert "This is a rehearsal." not in make_page(tmp_path, "--results", tmp_path / "results/thesis")[2]


def test_failed_cells_count():
    assert compare(["none", "good", ""], ["good", "good", "good"]) == "1 of 2" and count_good(["none", "good", ""]) == "1 of 2"
