"""What `snakemake -n` plans for metric heights and their table."""

import pytest

from helpers.running import planned


def test_heights_by_mast3r_are_in_the_table_where_its_weights_are(snakemake, tmp_path):
    weights = tmp_path / "mine.pth"
    weights.touch()
    (tmp_path / "images").mkdir()
    (tmp_path / "images/a.png").touch()
    row = f"photos\tsoap\t{tmp_path / 'images'}\t\t0.158\t{tmp_path / 'images'}\n"
    (tmp_path / "objects.tsv").write_text("dataset\tobject\timages\tmasks\theight_m\tmarker_images\n" + row)
    table = f"objects_table={tmp_path / 'objects.tsv'}"
    own = f"height={{mast3r: {{weights: {weights}}}}}"
    few = "datasets={demo: {objects: [mug, bowl]}}"
    jobs = planned(snakemake("-n", "results/demo/tables/height.csv", "--config", few, own).stdout)
    assert jobs["height_by_board"] == 4 and jobs["height_by_mast3r"] == 2
    assert "lacks the weights" in snakemake("-n", "results/photos/tables/height.csv", "--config", table).stdout
    run = snakemake("-n", "results/photos/tables/height.csv", "--config", table, own)
    assert planned(run.stdout)["height_by_mast3r"] == 1 and "--marker-images images --height-m 0.158" in run.stdout, run.stdout


def test_the_height_is_measured_as_the_row_says(snakemake, tmp_path):
    rows = {
        "given": ({"height_m": "0.1"}, ["--height known", "--height-m 0.1"]),
        "nothing": ({}, ["--height none"]),
        "board": ({"height_method": "marker"}, ["--height marker"]),
        "board_and_height": ({"height_method": "marker", "height_m": "0.1"}, ["--height marker", "--height-m 0.1"]),
        "board_apart": ({"height_method": "marker", "marker_images": str(tmp_path / "empty")}, ["--marker-images empty"]),
        "depth": ({"height_method": "depth_camera", "depth": str(tmp_path / "depth")}, ["--step-mm 1.0 --depth depth"]),
        "unwanted": ({"height_method": "none", "height_m": "0.1"}, ["--height none"]),
    }
    for name in ("images", "masks", "empty", "depth"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.png").touch()
    columns = ["dataset", "object", "images", "masks", "height_m", "height_method", "marker_images", "depth"]
    lines = ["\t".join(columns)]
    for name, (own, _) in rows.items():
        row = {"dataset": "photos", "object": name, "images": str(tmp_path / "images"), "masks": str(tmp_path / "masks"), **own}
        lines.append("\t".join(row.get(column, "") for column in columns))
    (tmp_path / "objects.tsv").write_text("\n".join(lines) + "\n")
    targets = [f"results/photos/{name}/video/colmap/2dgs/height.json" for name in rows]
    run = snakemake("-n", *targets, "--config", f"objects_table={tmp_path / 'objects.tsv'}")
    assert run.returncode == 0, run.stdout
    commands = [line for line in run.stdout.splitlines() if "--method shape" in line]
    assert len(commands) == len(rows)
    for name, (own, expected) in rows.items():
        [line] = [line for line in commands if f"results/photos/{name}/" in line]
        assert all(part in line for part in expected), line
        assert ("--board a4" in line) == (own.get("height_method") == "marker")


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"height_method": "depth_camera"}, "height_method depth_camera needs the folder"),
        ({"height_method": "mast3r"}, "height method mast3r cannot run here, it lacks the weights"),
        ({"height_method": "marker", "marker_images": "no/such/folder"}, "the folder of its marker_images, no/such/folder, does not exist"),
    ],
)
def test_a_height_that_cannot_be_measured_is_said_before_anything_runs(snakemake, tmp_path, columns, message):
    for name in ("images", "masks"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.png").touch()
    row = {"dataset": "photos", "object": "cup", "images": tmp_path / "images", "masks": tmp_path / "masks", "height_m": "", **columns}
    (tmp_path / "objects.tsv").write_text("\t".join(row) + "\n" + "\t".join(map(str, row.values())) + "\n")
    run = snakemake("-n", "results/photos/cup/2dgs.ply", "--config", f"objects_table={tmp_path / 'objects.tsv'}")
    assert run.returncode != 0
    assert message in run.stdout


@pytest.mark.slow
def test_the_table_of_heights_measures_every_object_twice(snakemake):
    run = snakemake("-n", "results/demo/tables/height.csv")
    assert run.returncode == 0, run.stdout
    jobs = planned(run.stdout)
    assert jobs["height_by_board"] == jobs["shape"] == jobs["register"] == 22
    assert jobs["capture_empty_scene"] == jobs["capture_with_board"] == jobs["capture_virtual"] == 11
