"""What the rules ask of the package when Snakemake plans: options, captures, methods, cells and tables, without Snakemake."""

import os
import re
import time

import pytest

from helpers.given import given_cameras, small_ring, write_lenses
from helpers.paths import REPOSITORY
from helpers.plan_places import DEFAULTS, place
from zeroshop_steps import methods
from zeroshop_steps.plan.datasets import require_known
from zeroshop_steps.plan.weights import list_files, list_sets, require_agreed
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import Failure, write_failure


def test_an_export_of_photos_takes_all_objects_that_they_show(make_plan):
    plan = make_plan({"table": {}, "table_1": {"scene_of": "table"}, "table_2": {"scene_of": "table"}, "cup": {}})
    find = plan.of_each_in_photos("results/{dataset}/{object}/{nvs}.ply".format_map)
    assert find(place(object="table")) == ["results/photos/table_1/2dgs.ply", "results/photos/table_2/2dgs.ply"]
    assert find(place()) == ["results/photos/cup/2dgs.ply"]


def test_config_keys_become_options(make_plan):
    plan = make_plan()
    options = {"max_features": 4000, "limits": [1, 2], "nothing": None, "weights": "my folder"}
    assert plan.options(options) == "--max-features 4000 --limits 1 2 --weights 'my folder'"
    assert plan.options({}) == ""


def test_methods_that_estimate_cameras_are_told_how_likely_wrong_these_may_be(make_plan):
    plan = make_plan(register={"max_wrong_probability": 0.2, "truth": {"seeds": 1}})
    assert {plan.verdict_option(place(registration=name)) for name in ("colmap", "given", "auto", "vggt_1024", "da3", "mast3r")} == {
        "--max-wrong-probability 0.2"
    }
    assert plan.verdict_option(place(registration="truth")) == "", "true cameras have no verdict"


def test_an_unknown_name_lists_what_exists(make_plan):
    plan = make_plan({"cup": {}})
    assert plan.check_object(place()) == "cup"
    with pytest.raises(StepError, match=r"unknown object of dataset photos: cap\. Did you mean cup\?"):
        plan.check_object(place(object="cap"))
    with pytest.raises(StepError, match="unknown dataset: demoo"):
        plan.objects("demoo")
    with pytest.raises(StepError, match="mug is another name of obj_000014"):
        plan.check_object(place(dataset="ycbv", object="mug"))
    with pytest.raises(StepError, match="Known: none"):
        require_known("thing", "x", [])


def test_pictures_are_found_by_their_row(make_plan, tmp_path):
    (tmp_path / "images").mkdir()
    for name in ("images/a.png", "images/.hidden", "images/{odd}.png", "can.mp4"):
        (tmp_path / name).touch()
    plan = make_plan(
        {"cup": {"images": "images", "picture_count": 30}, "can": {"images": "can.mp4", "picture_count": 61}, "box": {"images": "none"}}
    )
    assert plan.image_files(place()) == ["images/a.png"] and plan.files("masks")(place()) == []
    assert len(plan.odd_names(place())) == 1 and plan.odd_names(place())[0].startswith("'{odd}.png' 0 ")
    assert plan.capture_method(place()) == "photos" and "--most-images 30" in plan.capture_options(place())
    assert plan.capture_method(place(object="can")) == "video"
    assert plan.capture_options(place(object="can")).startswith("--frames 61 ") and "--most-frames 92" in plan.capture_options(
        place(object="can")
    )
    with pytest.raises(StepError, match="video or folder of its images, none, does not exist"):
        plan.images(place(object="box"))


def test_pictures_from_the_future_are_refused(make_plan, tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images/a.png").touch()
    os.utime(tmp_path / "images/a.png", (time.time() + 3600,) * 2)
    with pytest.raises(StepError, match=r"1 of the user's files are from the future, such as images/a\.png .* touch images/\*"):
        make_plan({"cup": {"images": "images"}}).image_files(place())


def test_rendered_films_have_a_row_that_is_made_up(make_plan):
    film = place(dataset="films", object="mug")
    plan = make_plan()
    assert plan.row(film)["images"] == "results/films/mug/film/film.mp4" and plan.height_method(film) == "marker"
    assert plan.row(place(dataset="films_wood", object="mug"))["marker_images"] == ""
    assert plan.passes(place(dataset="films_turned", object=plan.objects("films_turned")[0])) == ["video", "video_2"]
    assert plan.true_model(film) == "results/demo/mug/model" and plan.film_truth(film) == ["results/films/mug/film/truth"]


def test_a_height_is_measured_as_the_row_says(make_plan, tmp_path):
    (tmp_path / "depth").mkdir()
    (tmp_path / "images").mkdir()
    rows = {
        "cup": {"images": "images", "height_m": 0.1},
        "can": {"images": "images"},
        "box": {"images": "images", "height_method": "depth_camera"},
        "mug": {"images": "images", "height_method": "depth_camera", "depth": "depth"},
        "jar": {"images": "images", "cameras": "cameras.json"},
        "tin": {"images": "images", "cameras": "lenses.json"},
    }
    given_cameras(small_ring()).write(tmp_path / "cameras.json")
    write_lenses(tmp_path / "lenses.json")
    plan = make_plan(rows)
    named = {name: plan.height_method(place(object=name)) for name in rows}
    assert named == {"cup": "known", "can": "none", "box": "depth_camera", "mug": "depth_camera", "jar": "given_cameras", "tin": "none"}
    assert plan.chosen_run(place(object="jar"))["registration"] == "given"
    assert plan.chosen_run(place(object="tin")) == plan.config["chosen"]["photos"], "lenses alone do not say where cameras stand"
    assert "--height-m 0.1" in plan.height_options(place())
    with pytest.raises(StepError, match="height_method depth_camera needs the folder of depth images in the column depth"):
        plan.height_options(place(object="box"))
    (tmp_path / "depth/a.png").touch()
    assert "--depth depth" in plan.height_options(place(object="mug")) and plan.height_photos("depth")(place(object="mug")) == [
        "depth/a.png"
    ]


def test_methods_without_their_weights_are_refused_or_recorded(make_plan):
    cell = place(dataset="demo", object="mug", scene="su_h", registration="vggt")
    with pytest.raises(StepError, match="registration of a virtual dataset vggt cannot run here, it lacks"):
        make_plan().capture_of(cell)
    assert make_plan(refusals="record").capture_of(cell) == "results/demo/mug/su_h/capture"
    with pytest.raises(StepError, match="unknown scene of a virtual dataset: su_x"):
        make_plan().capture_of(place(dataset="demo", object="mug", scene="su_x"))
    with pytest.raises(StepError, match="all else needs cameras"):
        make_plan().capture_of(place(dataset="demo", object="mug", scene="su_h", registration="none"))


def test_a_surface_from_sparse_points_reads_no_stereo(make_plan):
    dense = make_plan()
    train = {**DEFAULTS["nvs"]["2dgs"]["train"], "initialization": "sparse"}
    sparse = make_plan(nvs={"2dgs": {**DEFAULTS["nvs"]["2dgs"], "train": train}})
    assert (
        dense.confirmed_depths(place()) == ["results/photos/cup/video/colmap/stereo/seeds.npz"] and sparse.confirmed_depths(place()) == []
    )
    assert set(dense.surface_inputs(dense.surfaces["2dgs"])) - set(sparse.surface_inputs(sparse.surfaces["2dgs"])) == {"stereo"}


def test_objects_alone_are_trained_with_their_own_iterations(make_plan):
    plan = make_plan(nvs={"2dgs": {"train": {"iterations": 30, "object_iterations": 7}}})
    options = plan.training_options(plan.surfaces["2dgs"])
    assert options(place()) == "--iterations 30" and options(place(scene="video_segmented")) == "--iterations 7"


def test_cells_are_every_combination_and_those_without_cameras_stand_apart(make_plan):
    said = []
    plan = make_plan(say=said.append, tables={"scenes": ["se"], "registrations": ["truth", "colmap"], "nvs": ["2dgs", "trellis"]})
    cells = plan.cells("demo", ["mug"])
    assert {(cell["registration"], cell["nvs"]) for cell in cells} == {
        (registration, nvs) for registration in ("truth", "colmap") for nvs in ("2dgs", "trellis")
    } | ({("none", "trellis")} if "trellis" in plan.without_cameras else set())
    assert said == [], "what is named is not left out"
    with pytest.raises(StepError, match="there is no such cell"):
        plan.cells("demo", ["mug"], ["se"], ["none"], ["2dgs"])
    with pytest.raises(StepError, match="unknown virtual dataset: photos"):
        plan.cells("photos", ["cup"])


def test_what_is_left_out_of_tables_is_said_once(make_plan):
    said = []
    plan = make_plan(say=said.append, tables={"detectors": "all"})
    for _ in range(2):
        plan.say_what_is_left_out("detectors")
    assert len(said) == 1 and "cnos lacks" in said[0]


def test_a_table_of_scores_has_every_run_with_every_set_of_models(make_plan):
    plan = make_plan(tables={"detectors": ["contour"], "estimators": ["render_compare"], "nvs": ["2dgs"], "poses": "all"})
    runs = ("contour-{}/precision", "render_compare-truth-{}/scores", "render_compare-contour-{}/scores")
    assert plan.scores(place(dataset="demo")) == [
        f"results/demo/bop/{run.format(models)}.csv" for models in ("models", "models_2dgs") for run in runs
    ]
    assert len(plan.robustness_scores(place(dataset="demo"))) == 8
    with pytest.raises(StepError, match=r"Photos have no test set\."):
        plan.scores(place())


def test_licences_are_agreed_to_before_the_first_download(make_plan, tmp_path):
    rows = list_files(list_sets(make_plan())["weights/mast3r"])
    said: list[str] = []
    with pytest.raises(StepError, match=r"CC BY-NC-SA 4\.0 .* --config licences=agreed \(once\)"):
        require_agreed(rows, False, said.append)
    assert said[0].startswith(rows[0].file) and said[-1].startswith("1 files, ")
    assert require_agreed(rows, True, said.append) == [str(row.path) for row in rows]
    (tmp_path / methods.WEIGHTS_FOLDER / "agreed").mkdir(parents=True)
    (tmp_path / methods.WEIGHTS_FOLDER / "agreed/mast3r.txt").write_text(rows[0].licence)
    assert require_agreed(rows, False, said.append), "agreed to before"


def test_a_page_is_made_of_the_chosen_cells_and_made_again_when_others_change(make_plan, tmp_path):
    mug, own = place(dataset="demo", object="mug"), DEFAULTS["chosen"]["virtual"]
    plan = make_plan(report={"cells": "chosen"}, tables={"nvs": ["2dgs"]})
    cell = f"results/demo/mug/{own['scene']}/{own['registration']}/2dgs"
    assert plan.parts_of_page(mug) == [f"{cell}/cell.csv"] and plan.first_shown(mug) == f"{own['scene']}/{own['registration']}"
    for folder in (cell, "results/demo/mug/se/truth/2dgs"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "mesh.ply").touch()
    assert [line.split()[0] for line in plan.other_cells(mug)] == ["results/demo/mug/se/truth/2dgs/mesh.ply"]
    assert make_plan(report={"cells": "present"}).parts_of_page(mug) == []
    assert plan.changes_option(REPOSITORY / "config/config.yaml") == "", "what only a page shows is no change"


def test_a_mesh_that_records_a_failure_is_told_from_one_that_is_there(make_plan, tmp_path):
    mesh = tmp_path / "results/photos/cup/video/colmap/2dgs/mesh.ply"
    mesh.parent.mkdir(parents=True)
    assert not make_plan().has_failed(place())
    mesh.write_text("ply\n")
    assert not make_plan().has_failed(place())
    write_failure([str(mesh)], Failure("finish.shape", "too few faces"))
    assert make_plan().has_failed(place())


def test_robots_know_true_models_and_delivered_ones_and_of_published_heights_misjudged_ones(make_plan):
    plan = make_plan(tables={"nvs": ["2dgs"]})
    assert plan.robots("demo") == ["models", "models_delivered_2dgs"]
    assert plan.robots("ycbv") == ["models", "models_delivered_2dgs", "models_misjudged_2dgs"]
    wrong = [path for path in plan.attempts(place(dataset="ycbv")) if "misjudged" in path]
    assert len(wrong) == len(plan.published_errors("ycbv")) == 8
    assert plan.aligned_mesh("demo", "mug", "models") == [] and len(plan.aligned_mesh("demo", "mug", "models_delivered_2dgs")) == 1


def test_another_name_of_an_object_stands_for_its_files(make_plan):
    plan = make_plan()
    assert plan.named_files(place(dataset="ycbv", object="mug"))[0] == "results/ycbv/obj_000014/2dgs.ply"
    assert re.search(plan.named, "results/ycbv/mug/2dgs.ply") and not re.search(plan.named, "results/demo/mug/2dgs.ply")
