"""The page of the thesis: every published figure once, ours beside it with its regime, and failed cells counted."""

import pandas as pd
import pytest

from helpers.paths import REPOSITORY
from zeroshop_steps.report.thesis import compare, count_good
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import write_json


def make_page(folder, *options):
    """Run the command; the rows of the CSV, and the page."""
    out = folder / "page"
    words = ["--method", "thesis", "--table", str(out / "thesis.csv"), "--out", str(out / "index.html"), *map(str, options)]
    assert stage_main("zeroshop_steps.report", words) == 0
    return pd.read_csv(out / "thesis.csv", dtype=str, na_filter=False), (out / "index.html").read_text()


def write_cell(root, place, grade, iterations=None, failed=False):
    """A cell's folder with a grade, or with a failed training."""
    cell = root / "ycbv" / place
    write_json(cell / "splats/training.json", {"settings": {"iterations": iterations}})
    if failed:
        write_failure([cell / "outcome.json"], Failure("surface.twodgs", "left 3 disks"))
        return
    write_json(cell / "grade.json", {"grade": grade})
    (cell / "mesh.ply").write_text("ply")


def test_without_results_the_recorded_figures_are_shown_as_such(tmp_path):
    table, page = make_page(tmp_path, "--recorded", REPOSITORY / "docs")
    sizes = {"4.1": 126, "4.2": 189, "4.3": 8, "4.4": 9, "4.5": 24, "4.6": 8}
    published = table[table.column != ""]
    assert published.groupby("table").size().to_dict() == sizes and not table.duplicated(["table", "row", "column"]).any()
    assert published.groupby("status").size().to_dict() == {"substituted": 337, "waiting": 23, "quoted": 4}
    assert set(table.regime) == {"", "defaults, recorded"} and not (table.status == "reproduced").any()
    assert "most by a printed board of known size" in page and "“As good” counts every cell" in page


def test_nothing_at_all_waits_for_what_it_lacks(tmp_path):
    table, page = make_page(tmp_path)
    assert set(table.status) == {"waiting", "quoted"} and (table.ours == "").all()
    full = table[table.row.str.contains("full precision")]
    assert set(full.how) == {"weights, a GPU"} and set(table[table.table == "4.6"].how) == {"a robot"}
    assert set(table[table.table == "4.4"].how) == {"the thesis's own films"}


def test_results_come_before_the_recorded_ones_and_name_their_regime(tmp_path):
    write_cell(tmp_path / "results", "obj_000001/su_h/mast3r/2dgs", "good", 800)
    write_cell(tmp_path / "results/thesis", "obj_000001/su_h/mast3r/2dgs", "sparse", 30000)
    write_cell(tmp_path / "results", "obj_000002/su_h/mast3r/2dgs", "good", 1234)
    write_cell(tmp_path / "results", "obj_000003/su_h/mast3r/2dgs", "good", 800, failed=True)
    write_cell(tmp_path / "results", "obj_000001/su_h/mast3r/svraster", "none", 5000)
    folders = tmp_path / "results", tmp_path / "results/thesis"
    table, _ = make_page(tmp_path, "--recorded", REPOSITORY / "docs", "--results", *folders)
    row = table[table.row == "2dgs, MASt3R-SfM, su_h"].set_index("column")
    found = row.loc[["obj_000001", "obj_000002", "obj_000003"], ["ours", "status", "regime"]].values.tolist()
    assert found == [["sparse", "reproduced", "thesis"], ["good", "reproduced", "1234 iterations"], ["none", "reproduced", "defaults"]]
    assert row.loc["obj_000004", ["status", "how", "regime"]].tolist() == ["substituted", "cameras by COLMAP", "defaults, recorded"]
    # Table 4.2 does not repeat SVRaster's marks by MASt3R in su_h: they are those of 2DGS.
    same = table[table.row == "svraster, MASt3R-SfM, su_h"].set_index("column")
    assert same.published.to_dict() == row.published.to_dict() and same.loc["obj_000001", "ours"] == "none"


@pytest.mark.parametrize("real", [True, False])
def test_scores_are_reproduced_only_by_the_same_method_on_real_images(tmp_path, real):
    rows = [("models", "detection", "cnos", "", "ap"), ("models", "pose", "render_compare", "truth", "ar")]
    columns = ["models", "task", "method", "masks", "measure"]
    table = pd.DataFrame(rows, columns=columns).assign(dataset="ycbv", object="", value="0.5", source="measured")
    table = pd.concat([table, table[:1].assign(measure="instances", value="4123")])
    (tmp_path / "results/ycbv/tables").mkdir(parents=True)
    table.to_csv(tmp_path / "results/ycbv/tables/bop.csv", index=False)
    scene = tmp_path / "results/ycbv/bop/test/000048"
    scene.parent.mkdir(parents=True)
    if real:
        (tmp_path / "elsewhere").mkdir()
        scene.symlink_to(tmp_path / "elsewhere")
    else:
        scene.mkdir()
    found, _ = make_page(tmp_path, "--results", tmp_path / "results")
    found = found[(found.table == "4.5") & (found.row == "ground truth")].set_index("column")
    assert found.loc["cnos, AP", "status"] == ("reproduced" if real else "substituted")
    other = found.loc["foundationpose, masks: truth, AR"]
    assert other.status == "substituted" and f"4123 instances in {'real' if real else 'rendered'} images" in other.how


def test_heights_by_mast3r_from_photos_of_the_same_object_are_reproduced(tmp_path):
    columns = {"registration": "colmap", "nvs": "2dgs", "how": "MASt3R", "height_m": "0.2", "measured_height_m": "0.21"}
    rows = [("photos", "soap", "5"), ("photos", "cup", "6"), ("ycbv", "obj_000005", "7")]
    for dataset in ("photos", "ycbv"):
        folder = tmp_path / "results" / dataset / "tables"
        folder.mkdir(parents=True)
        own = [dict(zip(("dataset", "object", "difference_percent"), row, strict=True)) | columns for row in rows if row[0] == dataset]
        pd.DataFrame(own).to_csv(folder / "height.csv", index=False)
    table, _ = make_page(tmp_path, "--results", tmp_path / "results")
    found = table[table.column.str.startswith("difference")].set_index("row")
    assert found.loc["soap", ["ours", "status"]].tolist() == ["5", "reproduced"]
    assert found.loc["mustard_bottle", ["ours", "status"]].tolist() == ["7", "substituted"]
    assert found.loc["mustard_bottle", "how"].startswith("MASt3R, rendered") and (found.status == "waiting").sum() == 15


def test_failed_cells_count():
    assert compare(["none", "good", ""], ["good", "good", "good"]) == "1 of 2" and count_good(["none", "good", ""]) == "1 of 2"
