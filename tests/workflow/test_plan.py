"""What `snakemake -n` plans for the targets that a user asks for, and how it refuses what does not exist."""

import re

import pytest

from helpers.paths import REPOSITORY
from helpers.pretend import pretend
from helpers.quick import first
from helpers.running import planned
from zeroshop_steps import methods

FINISH = ["clean", "height", "close", "frame", "unwrap", "texture", "evidence", "export", "grade", "preview", "publish"]
CELL = ["stereo", "train_2dgs", "fuse_2dgs", *FINISH]


def photo_table(folder, images, masks, height=""):
    """A table with one capture; returns the options that make the workflow read it."""
    table = folder / "objects.tsv"
    table.write_text(f"dataset\tobject\timages\tmasks\theight_m\nphotos\tcup\t{images}\t{masks}\t{height}\n")
    return "--config", f"objects_table={table}"


def test_the_default_target_is_the_demo_object(snakemake):
    run = snakemake("-n")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["demo_model", "capture_virtual", "register", "quality", *CELL, "all"], 1)
    assert "Rendering the views of mustard_bottle in scene su_h" in run.stdout


def test_a_bop_object(snakemake):
    run = snakemake("-n", "results/ycbv/obj_000005/2dgs.ply")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["bop_model", "capture_virtual", "register", "quality", *CELL], 1)


def test_a_name_that_people_know_is_a_link_to_the_numbered_files(snakemake, tmp_path):
    run = snakemake("-n", "results/ycbv/mustard_bottle/2dgs.ply")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["bop_model", "capture_virtual", "register", "quality", *CELL, "name_mesh"], 1)
    folder = tmp_path / "results/ycbv/obj_000005"
    folder.mkdir(parents=True)
    names = [f"2dgs.{end}" for end in ("ply", "png", "glb", "json", "preview.png")]
    for name in names:
        (folder / name).write_text(name)
    run = snakemake("--cores", "1", "--allowed-rules", "name_mesh", "--", "results/ycbv/mustard_bottle/2dgs.ply")
    assert run.returncode == 0, run.stdout
    for name in names:
        assert (tmp_path / "results/ycbv/mustard_bottle" / name).resolve() == folder / name


def test_real_test_images_take_the_place_of_rendered_ones(snakemake):
    real = "--config", "datasets={ycbv: {test_folder: some/ycbv}}"
    run = snakemake("-n", "results/ycbv/bop/test", "results/demo/bop/test", *real)
    jobs = planned(run.stdout)
    assert jobs["real_test_set"] == jobs["test_set"] == 1 and "/some/ycbv --models results/ycbv/bop/models" in run.stdout
    run = snakemake("-n", "results/ycbv/bop/test", "--config", "datasets={ycbv: {test_folder: download}}")
    assert "--dataset ycbv  --models" in run.stdout


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


def test_tables_in_another_folder_of_results_are_told_where_paths_begin(snakemake):
    few = "datasets={demo: {objects: [mug]}}", "tables={nvs: [2dgs], registrations: [truth], scenes: [su_h]}"
    wanted = [f"results/mine/demo/tables/{name}.csv" for name in ("cameras", "height", "bop")]
    run = snakemake("-n", *wanted, "--config", "results=results/mine", *few)
    assert run.returncode == 0, run.stdout
    commands = [line for line in run.stdout.splitlines() if re.search(r"report --method (table|heights|bop) ", line)]
    assert len(commands) == 3 and all(" --root results/mine --out " in line for line in commands), commands


def test_the_table_of_robustness_damages_true_models(snakemake):
    run = snakemake("-n", "results/ycbv/tables/robustness.csv")
    jobs = planned(run.stdout)
    assert jobs["damaged_models"] == 7 and jobs["estimate_poses"] == jobs["score_poses"] == 8 and "reconstructed_models" not in jobs
    assert "--scale-percent -10 " in run.stdout and "--open-underside " in run.stdout


def test_the_page_of_the_thesis_is_made_of_what_is_there_unless_all_is_asked_for(snakemake):
    run = snakemake("-n", "thesis")
    assert run.returncode == 0 and planned(run.stdout) == {"thesis": 1}, run.stdout
    run = snakemake("-n", "thesis", "--config", "thesis={make: all}", "datasets={ycbv: {objects: [obj_000005]}}", "tables={nvs: [2dgs]}")
    jobs = planned(run.stdout)
    assert jobs["thesis"] == jobs["height_table"] == jobs["bop_table"] == 1 and jobs["cell"] == 6


def test_the_same_object_by_sparse_voxels(snakemake):
    run = snakemake("-n", "results/demo/mustard_bottle/svraster.ply")
    assert run.returncode == 0, run.stdout
    steps = ["demo_model", "capture_virtual", "register", "quality", "stereo", "train_svraster", "mesh_svraster", *FINISH]
    assert planned(run.stdout) == dict.fromkeys(steps, 1)


def test_both_optimizers_share_one_stereo(snakemake):
    cell = "results/demo/mustard_bottle/su_h/colmap"
    run = snakemake("-n", f"{cell}/2dgs/raw_mesh.ply", f"{cell}/svraster/raw_mesh.ply")
    assert run.returncode == 0, run.stdout
    steps = ["demo_model", "capture_virtual", "register", "stereo", "train_2dgs", "fuse_2dgs", "train_svraster", "mesh_svraster"]
    assert planned(run.stdout) == dict.fromkeys(steps, 1)


def test_the_regime_of_the_thesis_lies_beside_the_default_one_and_runs_no_stereo(snakemake):
    objects = "results/thesis/demo/mustard_bottle"
    config = str(REPOSITORY / "config/thesis.yaml")
    run = snakemake("-n", f"{objects}/2dgs.ply", f"{objects}/su_h/colmap/svraster/raw_mesh.ply", "--configfile", config)
    assert run.returncode == 0, run.stdout
    steps = ["blender_environment", "demo_model", "capture_virtual", "register", "quality", "train_svraster", "mesh_svraster", *CELL]
    assert planned(run.stdout) == dict.fromkeys(set(steps) - {"stereo"}, 1)
    assert "--stereo results" not in run.stdout and "results/demo" not in run.stdout
    assert "--initialization sparse --iterations 30000" in run.stdout
    assert "--least-height-sizes 0 --light-strengths 1 1 1 1 1 1" in run.stdout


def test_models_from_a_local_folder(snakemake, tmp_path):
    models = tmp_path / "my models"
    run = snakemake("-n", "results/ycbv/obj_000005/model", "--config", f"datasets={{ycbv: {{models_folder: {models}}}}}")
    assert run.returncode == 0, run.stdout
    assert re.search(r"--models '?(\S*/)?my models'? ", run.stdout), run.stdout


def test_photos(snakemake, tmp_path):
    for name in ("images", "masks"):
        (tmp_path / "my cup" / name).mkdir(parents=True)
        (tmp_path / "my cup" / name / "a.png").touch()
    table = photo_table(tmp_path, tmp_path / "my cup/images", tmp_path / "my cup/masks", "0.12")
    run = snakemake("-n", "results/photos/cup/2dgs.ply", *table)
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["capture_photos", "register_photos", "segment", *CELL], 1)
    assert "--images 'my cup/images' --masks 'my cup/masks'" in run.stdout


@pytest.mark.slow
def test_the_row_of_a_photographed_cell_is_its_grade_alone(snakemake, tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images/a.png").touch()
    cell = "results/photos/cup/video/colmap/2dgs"
    pretend(lambda *words: snakemake(*words, *photo_table(tmp_path, tmp_path / "images", "")), tmp_path, f"{cell}/cell.csv")
    assert (tmp_path / cell / "grade.csv").exists() and not (tmp_path / cell / "quality.csv").exists()


@pytest.mark.slow
def test_photos_registered_by_the_object_alone(snakemake, tmp_path):
    """Given masks are there before anything is registered; without weights, others are found in the registered whole scene."""
    for name in ("images", "masks"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.png").touch()
    chosen = "chosen={photos: {scene: video_segmented}}"
    run = snakemake("-n", "results/photos/cup/2dgs.ply", *photo_table(tmp_path, tmp_path / "images", tmp_path / "masks"), chosen)
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["capture_photos", "capture_object", "register_photos", "segment", *CELL], 1)
    assert "--pictures results/photos/cup/video/capture " in run.stdout and "--scene video_segmented" in run.stdout
    run = snakemake("-n", "results/photos/cup/2dgs.ply", *photo_table(tmp_path, tmp_path / "images", ""), chosen)
    assert run.returncode == 0, run.stdout
    twice = dict.fromkeys(["register_photos", "segment"], 2)
    assert planned(run.stdout) == dict.fromkeys(["capture_photos", "capture_object", *CELL], 1) | twice
    assert "--pictures results/photos/cup/video/auto/cameras " in run.stdout
    assert "--method support_plane --scene results/photos/cup/video/auto/scene" in run.stdout
    assert "--method user_masks --scene results/photos/cup/video_segmented/auto/scene" in run.stdout


def test_the_height_is_measured_as_the_row_says(snakemake, tmp_path):
    rows = {
        "given": ({"height_m": "0.1"}, ["--method known", "--height-m 0.1"]),
        "nothing": ({}, ["--method none"]),
        "board": ({"height_method": "marker"}, ["--method marker"]),
        "board_and_height": ({"height_method": "marker", "height_m": "0.1"}, ["--method marker", "--height-m 0.1"]),
        "board_apart": ({"height_method": "marker", "marker_images": str(tmp_path / "empty")}, ["--marker-images empty"]),
        "depth": ({"height_method": "depth_camera", "depth": str(tmp_path / "depth")}, ["--step-mm 1.0 --depth depth"]),
        "unwanted": ({"height_method": "none", "height_m": "0.1"}, ["--method none"]),
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
    commands = [line for line in run.stdout.splitlines() if "zeroshop_steps.height" in line]
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
    assert jobs["height_by_board"] == jobs["clean"] == jobs["register"] == 22
    assert jobs["capture_empty_scene"] == jobs["capture_with_board"] == jobs["capture_virtual"] == 11


@pytest.mark.slow
def test_the_table_of_the_benchmark_runs_every_detector_and_estimator_on_every_set_of_models(snakemake):
    run = snakemake("-n", "results/demo/tables/bop.csv")
    assert run.returncode == 0, run.stdout
    assert all(f"{name} lacks" in run.stdout for name in ("cnos", "sam6d_ism", "foundationpose", "sam6d_pem"))
    jobs, sets, detectors = planned(run.stdout), 1 + able(methods.SURFACES), able(methods.DETECTORS)
    assert (jobs["contour"], jobs["score_detections"]) == (sets, sets * detectors)
    assert jobs["estimate_poses"] == jobs["score_poses"] == sets * able(methods.ESTIMATORS) * (1 + detectors)
    assert jobs["test_set"] == jobs["true_models"] == jobs["bop_table"] == 1
    commands = [line for line in run.stdout.splitlines() if "--method render_compare" in line]
    assert len(commands) == jobs["estimate_poses"]
    assert all(("--detections results/" in line) == ("render_compare-truth" not in line) for line in commands)
    assert not any("--detections --" in line for line in commands)
    named = snakemake("-n", "results/demo/bop/render_compare-cnos-models/poses.csv")
    assert named.returncode != 0 and "detector cnos cannot run here" in named.stdout


def test_poses_after_cnos_take_its_sure_masks_alone(snakemake, tmp_path):
    for name in methods.DETECTORS["cnos"].files:
        (tmp_path / methods.WEIGHTS_FOLDER / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / methods.WEIGHTS_FOLDER / name).touch()
    run = snakemake("-n", "results/demo/bop/render_compare-cnos-models/poses.csv")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout)["filter_masks"] == 1 and "--detections results/demo/bop/cnos-models/masks.json" in run.stdout


def test_poses_by_sam6d_are_planned_where_its_weights_are(snakemake, tmp_path):
    """With FastSAM's regions, so without the weights of SAM."""
    chosen = methods.DETECTORS["sam6d_ism"].with_options({"proposals": "fastsam"})
    for name in (*chosen.files, *methods.ESTIMATORS["sam6d_pem"].files):
        (tmp_path / methods.WEIGHTS_FOLDER / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / methods.WEIGHTS_FOLDER / name).touch()
    path = "results/demo/bop/sam6d_pem-sam6d_ism-models/scores.csv"
    run = snakemake("-n", path, "--config", "detect={sam6d_ism: {proposals: fastsam}}")
    assert run.returncode == 0, run.stdout
    jobs = planned(run.stdout)
    assert jobs["sam6d_ism"] == jobs["estimate_poses"] == jobs["templates"] == 1 and "filter_masks" not in jobs
    assert "--proposals fastsam" in run.stdout and "--templates results/demo/bop/templates/models/42" in run.stdout
    refused = snakemake("-n", path)
    assert refused.returncode != 0 and "sam-vit-huge/model.safetensors" in refused.stdout


def test_every_cell_of_the_matrix_has_a_path(snakemake):
    run = snakemake("-n", "results/demo/mustard_bottle/se/truth/2dgs/mesh.ply", "results/demo/mustard_bottle/su_l/colmap/2dgs/quality.csv")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout)["register"] == 2
    assert planned(run.stdout)["demo_model"] == 1


@pytest.mark.slow
def test_tables_cover_every_object(snakemake):
    run = snakemake("-n", "results/ycbv/tables/cameras.csv", "--config", "tables={registrations: [colmap]}")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout)["camera_error"] == 63


def able(table):
    """How many methods of a table "all" means in a folder without weights, such as those of these tests."""
    return sum(not (methods.lacks(method, REPOSITORY / "tests") or method.tries) for method in table.values())


ALL_CELLS = 3 * able(methods.REGISTRATIONS) * able(methods.SURFACES)


@pytest.mark.parametrize(
    ("target", "objects", "columns"),
    [
        ("results/demo/mug/su_l/truth/2dgs/cell.csv", 1, 1),
        ("results/demo/mug/cells.csv", 1, ALL_CELLS),
        pytest.param("results/ycbv/tables/se/colmap/2dgs.csv", 21, 1, marks=pytest.mark.slow),
        pytest.param("results/demo/tables/reconstruction.csv", 11, ALL_CELLS, marks=pytest.mark.slow),
        pytest.param("results/demo/tables/reconstruction.md", 11, ALL_CELLS, marks=pytest.mark.slow),
    ],
)
def test_a_slice_of_the_matrix_plans_exactly_its_cells(snakemake, target, objects, columns):
    run = snakemake("-n", target)
    assert run.returncode == 0, run.stdout
    jobs = planned(run.stdout)
    assert (jobs["cell"], jobs["outcome"]) == (objects * columns,) * 2
    assert jobs["demo_model" if "demo" in target else "bop_model"] == objects


def test_methods_that_cannot_run_are_left_out_with_one_line_and_refused_by_name(snakemake):
    run = snakemake("-n", "results/demo/mug/cells.csv")
    lines = [line for line in run.stdout.splitlines() if "Left out of tables" in line]
    assert len(lines) == 1 and "mast3r lacks" in lines[0] and "vggt lacks" in lines[0]
    assert "su_h/mast3r/" not in run.stdout
    named = snakemake("-n", "results/demo/mug/cells.csv", "--config", "tables={registrations: [colmap, mast3r]}")
    assert named.returncode != 0
    assert "mast3r cannot run here, it lacks" in named.stdout and "Those that can: colmap, truth, auto." in named.stdout
    for part in ("CC BY-NC-SA 4.0", "https://download.europe.naverlabs.com/", "snakemake resources/weights/MASt3R", "need no weights"):
        assert part in named.stdout
    assert "Left out of tables: trellis lacks" in named.stdout


UNKNOWN = [
    ("results/demo/mustad_bottle/2dgs.ply", "unknown object of dataset demo: mustad_bottle. Did you mean mustard_bottle"),
    ("results/demoo/mustard_bottle/2dgs.ply", "unknown dataset: demoo. Did you mean demo? Known: demo, ycbv, photos"),
    ("results/demoo/mustard_bottle/su_h/colmap/2dgs/mesh.ply", "unknown dataset: demoo. Did you mean demo?"),
    ("results/demoo/mustard_bottle/su_h/colmap/2dgs/cell.csv", "unknown dataset: demoo. Did you mean demo?"),
    ("results/demo/mustard_bottle/su_x/capture", "unknown scene of a virtual dataset: su_x. Did you mean su_"),
    ("results/demo/bop/train_su_x", "unknown scene of a virtual dataset: su_x. Did you mean su_"),
    ("results/demo/mustard_bottle/3dgs.ply", "unknown nvs method: 3dgs. Did you mean 2dgs? Known: 2dgs, svraster"),
    ("results/demo/mustard_bottle/su_x/colmap/2dgs/mesh.ply", "unknown scene of a virtual dataset: su_x."),
    ("results/demo/mustard_bottle/su_h/colmp/2dgs/mesh.ply", "unknown registration of a virtual dataset: colmp. Did you mean colmap"),
    ("results/photos/cap/2dgs.ply", "unknown object of dataset photos: cap. Did you mean cup? Known: cup."),
    ("results/photos/cup/su_h/colmap/2dgs/mesh.ply", "unknown scene of a photo dataset: su_h. Known: video, video_segmented"),
    ("results/photos/cup/2dgs.ply", "the video or folder of its images, photos/of/nothing, does not exist"),
    ("results/photos/tables/reconstruction.csv", "unknown virtual dataset: photos"),
    ("results/ycbv/mustad_bottle/2dgs.ply", "unknown object of dataset ycbv: mustad_bottle. Did you mean mustard_bottle"),
    ("results/ycbv/mustard_bottle/cells.csv", "mustard_bottle is another name of obj_000005; ask for this file"),
    ("results/demo/mog/cells.csv", "unknown object of dataset demo: mog. Did you mean mug?"),
    ("results/demo/tables/su_q/colmap/2dgs.csv", "unknown scene of a virtual dataset: su_q. Did you mean su_"),
    ("results/demo/tables/su_h/colmop/2dgs.csv", "unknown registration of a virtual dataset: colmop. Did you mean colmap"),
    ("results/demo/tables/su_h/colmap/nerf.csv", "unknown nvs method: nerf. Known: 2dgs"),
    ("results/demo/mug/su_h/vggt/2dgs/mesh.ply", "registration of a virtual dataset vggt cannot run here, it lacks"),
]


@pytest.mark.parametrize(("target", "message"), first(8, UNKNOWN))
def test_an_unknown_name_in_a_target_lists_what_exists(snakemake, tmp_path, target, message):
    run = snakemake("-n", target, *photo_table(tmp_path, "photos/of/nothing", "masks/of/nothing"))
    assert run.returncode != 0
    assert message in run.stdout


BAD_CONFIGS = [
    ("finish={texture_size: 512}", "unknown key in finish: texture_size. Did you mean texture_size_px?"),
    ("sed=1", "unknown key: sed. Did you mean seed?"),
    ("seed=-1", "seed: -1 is less than the minimum of 0"),
    ("finish={texture_size_px: big}", "finish.texture_size_px: 'big' is not of type 'integer'"),
    ("chosen={virtual: {scene: su_x}}", "chosen.virtual.scene: 'su_x' is not one of ['su_l', 'su_h', 'se']"),
    ("datasets={mine: {kind: bob}}", "datasets.mine.kind: 'bob' is not one of"),
    ("datasets={mine: {kind: bop}}", "datasets.mine: 'models_folder' is a required property"),
    ("objects_table=no/such.tsv", "such.tsv does not exist"),
    ("tables={scenes: every}", "tables.scenes: 'all' was expected"),
    ("tables={nvs: [nerf]}", "tables.nvs.0: 'nerf' is not one of"),
]


@pytest.mark.parametrize(("config", "message"), first(4, BAD_CONFIGS))
def test_a_bad_config_names_the_key(snakemake, config, message):
    run = snakemake("-n", "--config", config)
    assert run.returncode != 0
    assert message in run.stdout


def test_weights_are_downloaded_by_name_and_say_their_licence(snakemake):
    run = snakemake("-n", "resources/weights/VGGT-1B/model.safetensors")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == {"weights": 1} and "licence is: CC BY-NC 4.0" in run.stdout
    assert snakemake("-n", "resources/weights/other.pth").returncode != 0
