"""What `snakemake -n` plans for the targets that a user asks for."""

import re

from helpers.paths import REPOSITORY
from helpers.plans import CELL, FINISH
from helpers.running import planned
from zeroshop_steps import methods


def test_the_default_target_is_the_demo_object(snakemake):
    run = snakemake("-n")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["demo_model", "capture_virtual", "register", *CELL, "all"], 1)
    assert "Rendering the views of mustard_bottle in scene su_h" in run.stdout


def test_a_bop_object(snakemake):
    run = snakemake("-n", "results/ycbv/obj_000005/2dgs.ply")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["bop_model", "capture_virtual", "register", *CELL], 1)


def test_a_name_that_people_know_is_a_link_to_the_numbered_files(snakemake, tmp_path):
    run = snakemake("-n", "results/ycbv/mustard_bottle/2dgs.ply")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == dict.fromkeys(["bop_model", "capture_virtual", "register", *CELL, "name_mesh"], 1)
    folder = tmp_path / "results/ycbv/obj_000005"
    folder.mkdir(parents=True)
    names = [f"2dgs.{end}" for end in ("ply", "png", "glb", "json", "preview.png")]
    for name in names:
        (folder / name).write_text(name)
    run = snakemake("--cores", "1", "--allowed-rules", "name_mesh", "--", "results/ycbv/mustard_bottle/2dgs.ply")
    assert run.returncode == 0, run.stdout
    for name in names:
        assert (tmp_path / "results/ycbv/mustard_bottle" / name).resolve() == folder / name


def test_tables_in_another_folder_of_results_are_told_where_paths_begin(snakemake):
    few = "datasets={demo: {objects: [mug]}}", "tables={nvs: [2dgs], registrations: [truth], scenes: [su_h]}"
    wanted = [f"results/mine/demo/tables/{name}.csv" for name in ("cameras", "height", "bop")]
    run = snakemake("-n", *wanted, "--config", "results=results/mine", *few)
    assert run.returncode == 0, run.stdout
    commands = [line for line in run.stdout.splitlines() if re.search(r"report --method (table|heights|bop) ", line)]
    assert len(commands) == 3 and all(" --root results/mine " in line for line in commands), commands


def test_the_page_of_the_thesis_is_made_of_what_is_there(snakemake):
    run = snakemake("-n", "thesis")
    assert run.returncode == 0 and planned(run.stdout) == {"thesis": 1}, run.stdout


def test_the_same_object_by_sparse_voxels(snakemake):
    run = snakemake("-n", "results/demo/mustard_bottle/svraster.ply")
    assert run.returncode == 0, run.stdout
    steps = ["demo_model", "capture_virtual", "register", "stereo", "train_svraster", "mesh_svraster", *FINISH, "evaluate"]
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
    run = snakemake("-n", f"{objects}/2dgs.ply", f"{objects}/su_h/mast3r/svraster/raw_mesh.ply", "--configfile", config)
    assert run.returncode == 0, run.stdout
    steps = ["blender_environment", "demo_model", "capture_virtual", "register", "train_svraster", "mesh_svraster", *CELL]
    assert planned(run.stdout) == dict.fromkeys(set(steps) - {"stereo"}, 1)
    assert "--stereo results" not in run.stdout and "results/demo" not in run.stdout
    assert "--initialization sparse --iterations 30000" in run.stdout and "--object-iterations" not in run.stdout
    assert "--initialization sparse --iterations 5000 --image-width-px 250" in run.stdout
    alone = snakemake("-n", f"{objects}/se/mast3r/svraster/raw_mesh.ply", "--configfile", config)
    assert "--initialization sparse --iterations 3000 --image-width-px 250" in alone.stdout, alone.stdout
    assert "--least-height-sizes 0 --light-strengths 1 1 1 1 1 1" in run.stdout


def test_models_from_a_local_folder(snakemake, tmp_path):
    models = tmp_path / "my models"
    run = snakemake("-n", "results/ycbv/obj_000005/model", "--config", f"datasets={{ycbv: {{models_folder: {models}}}}}")
    assert run.returncode == 0, run.stdout
    assert re.search(r"--models '?(\S*/)?my models'? ", run.stdout), run.stdout


def test_weights_are_downloaded_by_name_and_say_their_licence(snakemake):
    run = snakemake("-n", "resources/weights/VGGT-1B/model.safetensors")
    assert run.returncode == 0, run.stdout
    assert planned(run.stdout) == {"weights_file": 1} and "licence is: CC BY-NC 4.0" in run.stdout
    assert snakemake("-n", "resources/weights/other.pth").returncode != 0


def test_all_weights_of_the_thesis_are_one_word_and_their_licences_are_agreed_to_once(snakemake, tmp_path):
    asked = snakemake("-n", "weights")
    assert asked.returncode != 0 and "23 files, 13.8 GB" in asked.stdout and "--config licences=agreed (once)" in asked.stdout
    for part in ("CC BY-NC-SA 4.0", "NVIDIA Source Code License", "AGPL-3.0", "VGGT-1B/model.safetensors: 5026 MB"):
        assert part in asked.stdout
    run = snakemake("-n", "weights", "--config", "licences=agreed")
    assert run.returncode == 0 and planned(run.stdout) == {"weights_file": 23, "agree_licences": 1, "weights": 1}, run.stdout
    assert "birefnet" not in run.stdout and "FastSAM-x.pt" in run.stdout and "sam-vit-huge" in run.stdout
    one = methods.REGISTRATIONS["mast3r"].weights[0]
    few = planned(snakemake("-n", "weights/mast3r", "--config", "licences=agreed").stdout)
    assert few == {"weights_file": 1, "agree_licences": 1, "weights/mast3r": 1}
    (tmp_path / "resources/weights").mkdir(parents=True)
    (tmp_path / "resources/weights" / one).touch()
    assert snakemake("weights/mast3r").returncode == 0, "what is there has been agreed to"
    assert (tmp_path / "resources/weights/agreed/mast3r.txt").read_text() == "CC BY-NC-SA 4.0 (non-commercial)\n"
    (tmp_path / "resources/weights" / one).unlink()
    again = snakemake("-n", "weights/mast3r")
    assert again.returncode == 0 and planned(again.stdout)["weights_file"] == 1, "asked once"
    assert snakemake("-n", "weights/vggt").returncode != 0
