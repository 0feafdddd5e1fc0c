"""Rendered films are planned as a user's videos are."""

from helpers.running import planned


def test_a_rendered_film_goes_the_way_of_a_video(snakemake):
    run = snakemake("-n", "results/films/mug/video/colmap/2dgs/height.json")
    assert run.returncode == 0, run.stdout
    steps = ["demo_model", "film", "capture_photos", "register_photos", "segment", "stereo", "train_2dgs", "fuse_2dgs", "shape"]
    assert planned(run.stdout) == dict.fromkeys(steps, 1)
    assert "--method video --images results/films/mug/film/film.mp4" in run.stdout
    assert "--method support_plane --scene" in run.stdout and "--board empty_scene" in run.stdout
    assert "--height marker" in run.stdout and "--marker-images results/films/mug/film/empty_scene" in run.stdout


def test_the_board_beside_the_object_needs_no_photos_of_the_empty_scene(snakemake):
    run = snakemake("-n", "results/films_board/obj_000005/video/colmap/2dgs/height.json")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout)["bop_model"] == 1
    assert "--board beside" in run.stdout and "--marker-images" not in run.stdout


def test_a_plain_table_is_a_dataset_of_its_own(snakemake):
    run = snakemake("-n", "results/films_glossy/mug/film/film.mp4")
    assert "--table glossy" in run.stdout
    assert "--height none" in snakemake("-n", "results/films_glossy/mug/video/colmap/2dgs/height.json").stdout
    assert "--table print" in snakemake("-n", "results/films/mug/film/film.mp4").stdout


def test_the_tables_of_films_cover_every_film(snakemake):
    run = snakemake("-n", "results/films/tables/masks.csv", "results/films/tables/film_height.csv")
    assert run.returncode == 0, run.stdout
    jobs = planned(run.stdout)
    assert jobs["film"] == jobs["mask_error"] == jobs["shape"] >= 10
    assert jobs["mask_table"] == jobs["film_height_table"] == 1


def test_the_meshes_of_films_are_measured_against_the_truth(snakemake):
    run = snakemake("-n", "results/films_white/tables/reconstruction.csv", "results/films_white/tables/cameras.csv")
    assert run.returncode == 0, run.stdout
    jobs = planned(run.stdout)
    assert jobs["film"] == jobs["camera_error"] == jobs["cell"] / 2 == 8  # by two surface methods
    mesh = snakemake("-n", "results/films_white/mug/video/colmap/2dgs/quality.json").stdout
    assert "--model results/demo/mug/model " in mesh and "--film-truth results/films_white/mug/film/truth" in mesh
    assert "--truth results/films_white/mug/film/truth --film-capture results/films_white/mug/video/capture" in run.stdout


def test_a_thing_that_is_filmed_twice_becomes_one_mesh_of_both_films(snakemake):
    run = snakemake("-n", "results/films_turned/mug/2dgs.ply", "results/films_turned/mug/video_joined/auto/camera_error.csv")
    assert run.returncode == 0, run.stdout
    jobs = planned(run.stdout)
    assert jobs["film"] == jobs["turned_film"] == jobs["join_captures"] == jobs["join_passes"] == jobs["train_2dgs"] == 1
    assert "--model results/demo/mug/turned_model/model.ply" in run.stdout
    truths = "--film-truths results/films_turned/mug/film/truth results/films_turned/mug/film_2/truth"
    assert f"--turned results/demo/mug/turned_model {truths}" in run.stdout
    assert "--truth results/films_turned/mug/video_joined/capture/truth" in run.stdout
    second = snakemake("-n", "results/films_turned/mug/video_2/auto/mask_error.csv").stdout
    assert "--truth results/films_turned/mug/film_2/truth" in second
