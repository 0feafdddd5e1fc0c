"""Folders of the thesis's published pipeline become rows of the table of photos."""

import csv

import numpy as np
import pytest
import trimesh

from helpers.paths import REPOSITORY
from zeroshop_steps import methods
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.config_files import read_objects

SCHEMA = REPOSITORY / "workflow/schemas/objects.schema.yaml"


@pytest.fixture
def soap(tmp_path):
    """A folder with three photos, masks named as COLMAP's, cameras, a point cloud and a mesh 158 mm high."""
    folder = tmp_path / "theirs/soap"
    for number in range(3):
        write_image(folder / f"images/{number}.png", np.zeros((48, 64, 3), np.uint8))
        write_mask(folder / f"masks/{number}.png.png", np.ones((48, 64), bool))
    (folder / "sparse/0").mkdir(parents=True)
    (folder / "sparse/0/cameras.bin").touch()
    box = trimesh.creation.box((40, 60, 158))
    write_ply(folder / "mesh/soap.ply", Mesh(np.asarray(box.vertices), np.asarray(box.faces)))
    trimesh.PointCloud(box.vertices).export(folder / "points.ply")
    return folder


def take(tmp_path, *folders):
    words = ["--method", "import_folders", "--out", str(tmp_path / "mine/objects.tsv"), "--folders", *map(str, folders)]
    return stage_main("zeroshop_steps.capture", words)


def test_a_folder_is_a_row_with_the_height_of_its_mesh(soap, tmp_path, capsys):
    assert take(tmp_path, soap) == 0
    [((dataset, name), row)] = read_objects(tmp_path / "mine/objects.tsv", SCHEMA, methods.HEIGHTS, methods.GIVEN_HEIGHTS).items()
    assert (dataset, name, row["height_m"], row["images"]) == ("photos", "soap", 0.158, str(soap / "images"))
    assert row["masks"] == str(soap / "masks")
    said = capsys.readouterr().out
    assert said.count("compare_meshes") == 1 and f"--others {soap}/mesh/soap.ply" in said and f"--other-cameras {soap}/sparse/0" in said


def test_a_height_that_was_only_assumed_is_left_out(soap, tmp_path, capsys):
    box = trimesh.creation.box((40, 60, 200))
    write_ply(soap / "mesh/soap.ply", Mesh(np.asarray(box.vertices), np.asarray(box.faces)))
    assert take(tmp_path, soap) == 0
    assert "takes for unknown heights" in capsys.readouterr().err
    assert (tmp_path / "mine/objects.tsv").read_text().splitlines()[1].endswith("\t")


def test_what_is_missing_is_named(soap, tmp_path, capsys):
    (soap / "masks/1.png.png").unlink()
    assert take(tmp_path, soap) == 1
    assert "has no mask of 1.png" in capsys.readouterr().err
    assert take(tmp_path, tmp_path / "theirs") == 1
    assert "has no folder images or input" in capsys.readouterr().err and not (tmp_path / "mine/objects.tsv").exists()


def test_the_template_has_the_published_heights():
    rows = read_objects(REPOSITORY / "config/thesis_objects.tsv", SCHEMA, methods.HEIGHTS, methods.GIVEN_HEIGHTS)
    with (REPOSITORY / "src/zeroshop_steps/report/published_heights.csv").open() as file:
        published = {("photos", row["name"]): float(row["height_m"]) for row in csv.DictReader(file)}
    assert {key: row["height_m"] for key, row in rows.items()} == published and len(rows) == 17
