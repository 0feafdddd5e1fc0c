"""A method is a file and a line of config: a new registration and two new surface methods, added as a user would, run in cells."""

import csv

import pytest

from helpers.checkout import copy_checkout
from helpers.planner import call_snakemake
from helpers.solids import as_trimesh
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.runtime.files import read_json

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

COPIED = '''"""Cameras copied from the renderer: a registration in ten lines."""

from zeroshop_steps.register import truth

METHOD = {"true_cameras": True, "runtime_min": 5}


def add_arguments(parser):
    truth.add_arguments(parser)
    parser.add_argument("--greeting", default="hello")
    parser.add_argument("--seed", type=int)


def run(args):
    print(args.greeting)
    truth.run(args)
'''
HULL = '''"""The visual hull: a surface that needs no stereo and no training."""

from pathlib import Path

import numpy as np
from skimage.measure import marching_cubes

from zeroshop_steps.geometry.cameras.object_crops import fit_object_sphere
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.geometry.cameras.registered_views import read_object_masks, read_views
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.runtime.files import write_json

METHOD = {"stereo": False}


def add_arguments(parser):
    parser.add_argument("--cameras", type=Path, required=True)
    parser.add_argument("--voxels", type=int, default=32)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--out", type=Path, required=True)


def run(args):
    views, model = read_views(args.cameras)
    masks = read_object_masks(views)
    sphere = fit_object_sphere(model.cameras, masks)
    hull = VisualHull.carve([sphere.normalized(view.camera) for view in views], masks, 1.0, args.voxels)
    vertices, faces, _, _ = marching_cubes(np.pad(hull.occupied, 1).astype(np.float32), 0.5)
    points = (vertices - 0.5) / args.voxels * 2 - 1
    write_ply(args.out, Mesh(sphere.centre + sphere.radius * points, faces[:, ::-1].astype(np.int64)))
    write_json(args.out.with_suffix(".json"), {"seconds": 0.0})
'''
GUESS = '''"""A ball as large as the first mask: a surface that needs no cameras."""

from pathlib import Path

import numpy as np
import trimesh

from zeroshop_steps.geometry.imaging.images import read_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.files import write_json

METHOD = {"stereo": False, "registration": False}


def add_arguments(parser):
    parser.add_argument("--capture", type=Path, required=True)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--out", type=Path, required=True)


def run(args):
    ball = trimesh.creation.icosphere(2, float(np.sqrt(read_mask(sorted((args.capture / "masks").iterdir())[0]).sum())))
    write_ply(args.out, Mesh(np.array(ball.vertices), np.array(ball.faces)))
    write_json(args.out.with_suffix(".json"), {"seconds": 0.0})
'''
CONFIG = """
capture: {image_width_px: 320, image_height_px: 240, views_per_ring: 6}
finish: {texture_size_px: 256, clean: {max_faces: 3000}}
register: {copied: {greeting: welcome}}
nvs: {hull: {voxels: 40}}
tables: {scenes: [se], registrations: [copied], nvs: [hull, guess]}
"""
CELL = "results/demo/tuna_can/se/copied/hull"


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A copy of the project with the three files and the lines of config, and a call of Snakemake there."""
    folder = tmp_path_factory.mktemp("checkout")
    environment = copy_checkout(folder)
    package = folder / "src/zeroshop_steps"
    for name, text in {"register/copied.py": COPIED, "surface/hull.py": HULL, "surface/guess.py": GUESS}.items():
        (package / name).write_text(text)
    (folder / "mine.yaml").write_text(CONFIG)

    def call(*words):
        return call_snakemake(folder, ["--cores", "2", *words, "--configfile", "mine.yaml"], environment)

    return folder, call


def test_a_cell_of_a_new_registration_and_a_new_surface_is_finished(checkout):
    folder, call = checkout
    run = call(f"{CELL}/mesh.ply", f"{CELL}/grade.json")
    assert run.returncode == 0, run.stdout
    mesh = read_ply(folder / CELL / "mesh.ply")
    assert len(mesh.faces) > 100 and mesh.texture is not None
    assert "welcome" in (folder / CELL).parent.joinpath("logs/register.log").read_text()
    assert not (folder / CELL).parent.joinpath("stereo").exists(), "nobody asked for stereo"
    assert read_json(folder / CELL / "grade.json")["grade"] in ("none", "sparse", "good")


def test_a_surface_without_cameras_ends_with_its_raw_mesh(checkout):
    folder, call = checkout
    raw = "results/demo/tuna_can/se/none/guess/raw_mesh.ply"
    run = call(raw)
    assert run.returncode == 0, run.stdout
    assert as_trimesh(read_ply(folder / raw)).is_watertight
    finished = call("results/demo/tuna_can/se/none/guess/mesh.ply")
    assert finished.returncode != 0 and "a cell of registration none ends with its raw mesh" in finished.stdout


def test_wrong_options_and_unknown_names_are_said(checkout):
    _, call = checkout
    unknown = call("results/demo/tuna_can/se/copied/nerf/mesh.ply")
    assert unknown.returncode != 0 and "Known: 2dgs, svraster, trellis, guess, hull" in unknown.stdout


def test_a_surface_without_cameras_is_a_row_with_its_reason(checkout):
    folder, call = checkout
    plan = call("-n", "results/demo/mug/cells.csv", "--config", "tables={nvs: all}")
    assert plan.returncode == 0, plan.stdout
    assert "train_hull" in plan.stdout and "results/demo/mug/se/none/guess/raw_mesh.ply" in plan.stdout
    assert "copied/guess" not in plan.stdout and "none/hull" not in plan.stdout
    row = "results/demo/tables/se/none/guess.csv"
    run = call(row, "--config", "datasets={demo: {objects: [tuna_can]}}")
    assert run.returncode == 0, run.stdout
    [cell] = csv.DictReader((folder / row).read_text().splitlines())
    assert (cell["object"], cell["registration"], cell["nvs"]) == ("tuna_can", "none", "guess")
    assert (cell["measure"], cell["value"]) == ("grade", "none") and "made without cameras" in cell["reason"]


def test_tables_of_finished_meshes_go_without_it(checkout):
    _, call = checkout
    cameras = call("-n", "results/demo/tables/cameras.csv", "--config", "tables={nvs: all}")
    assert cameras.returncode == 0 and "guess" not in cameras.stdout, cameras.stdout
    mixed = call("-n", "results/demo/tables/se/copied/guess.csv")
    assert mixed.returncode != 0 and "guess goes with registration none" in mixed.stdout
    heights = call("-n", "results/demo/tables/height.csv", "--config", "tables={nvs: [guess]}")
    assert heights.returncode != 0 and "the table of heights needs a surface method that uses cameras" in heights.stdout
