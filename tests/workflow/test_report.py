"""Asking for a dataset's report: what is made for it, and that an empty dataset has one, too."""

import zipfile

import pytest

from helpers.pretend import pretend
from helpers.running import planned


def test_a_report_waits_for_the_chosen_cell_of_every_object_and_method(snakemake):
    run = snakemake("-n", "results/demo/report/index.html", "--config", "datasets={demo: {objects: [mug, bowl]}}")
    jobs = planned(run.stdout)
    assert run.returncode == 0, run.stdout
    assert (jobs["report_index"], jobs["report_object"], jobs["register"], jobs["stereo"]) == (1, 2, 2, 2)
    assert (jobs["train_2dgs"], jobs["train_svraster"]) == (2, 2)
    assert """--config 'datasets={"demo": {"objects": ["mug", "bowl"]}}' --out""" in run.stdout, "the page says how it was made"


def test_a_report_of_what_is_present_makes_nothing_else(snakemake, tmp_path):
    (tmp_path / "results/demo/mug/su_h/colmap/2dgs").mkdir(parents=True)
    arguments = ("--config", "datasets={demo: {objects: [mug, bowl]}}", "report={cells: present}")
    run = snakemake("-n", "results/demo/report/index.html", *arguments)
    assert planned(run.stdout) == {"report_index": 1, "report_object": 2}, run.stdout


def test_a_report_of_photos_and_films_waits_for_their_chosen_cells(snakemake, tmp_path):
    (tmp_path / "images").mkdir()
    rows = f"dataset\tobject\timages\tmasks\theight_m\nphotos\tcup\t{tmp_path / 'images'}\t\t\n"
    (tmp_path / "table.tsv").write_text(rows)
    changes = (f"objects_table={tmp_path / 'table.tsv'}", "datasets={films: {of: {demo: [mug]}}}")
    for dataset, source in (("photos", "capture_photos"), ("films", "film")):
        run = snakemake("-n", f"results/{dataset}/report/index.html", "--config", *changes)
        jobs = planned(run.stdout)
        assert run.returncode == 0, run.stdout
        assert jobs[source] == jobs["report_object"] >= 1 and jobs["report_index"] == 1, jobs


@pytest.mark.slow
def test_an_empty_dataset_has_a_report(snakemake, tmp_path):
    (tmp_path / "none.tsv").write_text("dataset\tobject\timages\tmasks\theight_m\n")
    run = snakemake("results/photos/report/index.html", "--config", f"objects_table={tmp_path / 'none.tsv'}")
    assert run.returncode == 0, run.stdout
    assert "no objects yet" in (tmp_path / "results/photos/report/index.html").read_text()
    again = snakemake("results/photos/report/index.html", "--config", f"objects_table={tmp_path / 'none.tsv'}")
    assert "Nothing to be done" in again.stdout


@pytest.mark.slow
def test_snakemakes_own_report_has_captions_and_categories(snakemake, tmp_path):
    arguments = ("--config", "datasets={demo: {objects: [mug]}}", "tables={scenes: [su_h], registrations: [colmap], nvs: [2dgs]}")
    targets = [f"results/demo/{name}" for name in ("tables/reconstruction.md", "tables/cameras.csv", "mug/2dgs.ply")]
    pretend(lambda *words: snakemake(*words, *arguments), tmp_path, *targets)
    run = snakemake("--report", "own.zip", *targets, *arguments)
    assert run.returncode == 0, run.stdout
    with zipfile.ZipFile(tmp_path / "own.zip") as report:
        texts = " ".join(report.read(name).decode() for name in report.namelist() if name.endswith((".js", ".html")))
    assert "red is a surface seen from behind" in texts, "the caption of the preview"
    assert "min_share" in texts, "captions are there"
    assert all(name in texts for name in ("Meshes", "Tables", "camera errors", "2dgs.preview.png"))


@pytest.mark.slow
def test_snakemakes_own_report_names_a_result_that_is_gone(snakemake, tmp_path):
    target = "results/demo/mug/2dgs.ply"
    pretend(snakemake, tmp_path, target)
    for record in (tmp_path / ".snakemake/metadata").iterdir():
        record.write_bytes(b"{damaged")
    assert snakemake("--report", "own.zip", target).returncode == 0, "what Snakemake recorded is not needed"
    (tmp_path / "own.zip").unlink()
    (tmp_path / "results/demo/mug/2dgs.preview.png").unlink()
    run = snakemake("--report", "own.zip", target)
    assert run.returncode != 0 and "2dgs.preview.png marked for report but does not exist" in run.stdout
    assert "Traceback" not in run.stdout and not (tmp_path / "own.zip").exists()
