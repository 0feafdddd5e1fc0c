import csv

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.carton_scene import SIZE_MM
from zeroshop_steps.evaluate import quality
from zeroshop_steps.evaluate.quality import GroundTruth, measure_quality
from zeroshop_steps.geometry.alignment.surface_distance import count_seeing_views, measure_surface_error
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.cameras.registered_views import read_first_cameras, read_views
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json


@pytest.fixture(scope="module")
def truth_side(carton):
    cameras = read_sparse_model(carton.capture / "truth").cameras
    held_out, _ = read_views(carton.capture / "held_out", sparse="truth")
    return cameras, held_out


def graded(carton, truth_side, mesh: Mesh, registered=None, object_from_registration=None) -> dict:
    cameras, held_out = truth_side
    similarity = np.eye(4) if object_from_registration is None else object_from_registration
    diameter_mm, bottom_mm = float(np.linalg.norm(SIZE_MM)), float(-SIZE_MM[2] / 2)
    return measure_quality(mesh, similarity, registered or cameras, GroundTruth(carton.mesh, diameter_mm, bottom_mm, cameras, held_out))


def test_the_truth_itself_is_perfect(carton, truth_side):
    figures = graded(carton, truth_side, carton.mesh)
    assert figures["accuracy_mm"] < 1e-3 and figures["completeness_mm"] < 1e-3
    assert figures["f_score_1_percent"] == figures["f_score_2_mm"] == 1.0
    assert figures["normal_error_deg"] < 0.1
    assert abs(figures["scale_error_percent"]) < 1e-3 and figures["up_error_deg"] < 1e-3
    assert figures["psnr_db"] > 40.0 and figures["silhouette_iou"] > 0.999


def test_a_film_has_no_held_out_photos(carton, truth_side):
    figures = graded(carton, (truth_side[0], []), carton.mesh)
    assert figures["accuracy_mm"] < 1e-3 and "psnr_db" not in figures


def test_any_registration_frame_gives_the_same_figures(carton, truth_side):
    registration_from_truth = np.eye(4)
    registration_from_truth[:3, :3] = 0.013 * Rotation.from_euler("xyz", [20, 50, 110], degrees=True).as_matrix()
    registration_from_truth[:3, 3] = (1.0, -2.0, 3.0)
    registered = tuple(transform_camera(camera, registration_from_truth) for camera in truth_side[0])
    figures = graded(carton, truth_side, carton.mesh, registered, np.linalg.inv(registration_from_truth))
    assert figures["accuracy_mm"] < 1e-3 and figures["psnr_db"] > 40.0
    assert abs(figures["scale_error_percent"]) < 1e-3


@pytest.mark.parametrize("shift_mm", [0.5, 1.5, 3.0])
def test_a_shift_along_a_side_shows_as_its_size(carton, truth_side, shift_mm):
    """All of a slab's surface moves along z: its top and bottom by the shift, its sides not at all."""
    moved = Mesh(carton.mesh.vertices + [0.0, 0.0, shift_mm], carton.mesh.faces, None, carton.mesh.uv, carton.mesh.texture)
    figures = graded(carton, truth_side, moved)
    x, y, z = SIZE_MM
    flat, upright = 2 * x * y, 2 * (x + y) * z
    # what the bottom's rim gains by being nearer to the sides, the sides lose where they stand above the truth
    assert figures["accuracy_mm"] == pytest.approx(shift_mm * flat / (flat + upright), rel=0.02)
    assert figures["psnr_db"] < 35.0


def test_a_wrong_height_shows_as_scale_error_alone(carton, truth_side):
    similarity = np.diag([1.02, 1.02, 1.02, 1.0])
    larger = Mesh(carton.mesh.vertices * 1.02, carton.mesh.faces, None, carton.mesh.uv, carton.mesh.texture)
    figures = graded(carton, truth_side, larger, None, similarity)
    assert figures["scale_error_percent"] == pytest.approx(2.0, abs=1e-3)
    assert figures["accuracy_mm"] < 1e-3


def test_a_tilted_frame_shows_as_up_error(carton, truth_side):
    similarity = np.eye(4)
    similarity[:3, :3] = Rotation.from_euler("x", 3.0, degrees=True).as_matrix()
    tilted = Mesh(carton.mesh.vertices @ similarity[:3, :3].T, carton.mesh.faces, None, carton.mesh.uv, carton.mesh.texture)
    assert graded(carton, truth_side, tilted, None, similarity)["up_error_deg"] == pytest.approx(3.0, abs=1e-3)


def test_missing_surface_costs_completeness_and_not_accuracy(carton, truth_side):
    upper = (carton.mesh.vertices[carton.mesh.faces][:, :, 2] > 0).all(1)
    figures = measure_surface_error(Mesh(carton.mesh.vertices, carton.mesh.faces[upper]), carton.mesh, list(truth_side[0]), -SIZE_MM[2] / 2)
    assert figures.to_truth_mm.mean() < 1e-3
    assert figures.to_mesh_mm.mean() > 5.0
    assert figures.f_score(2.0) < 0.8


def test_the_side_on_the_table_is_not_asked_for(carton, truth_side):
    points = np.array([[0.0, 0.0, -SIZE_MM[2] / 2], [0.0, 0.0, SIZE_MM[2] / 2], [SIZE_MM[0] / 2, 0.0, 0.0]])
    normals = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    below = list(truth_side[0])
    below.append(transform_camera(below[1], np.diag([1.0, -1.0, -1.0, 1.0])))  # a camera under the table
    with_table = count_seeing_views(points, normals, carton.mesh, below, -SIZE_MM[2] / 2)
    without_table = count_seeing_views(points, normals, carton.mesh, below, None)
    assert with_table[0] == 0 and with_table[1] == with_table[2] == 5
    assert without_table[0] == 1


def test_two_registered_cameras_cannot_be_aligned(carton, truth_side):
    with pytest.raises(StepError, match="3 are needed"):
        graded(carton, truth_side, carton.mesh, truth_side[0][:2])


def test_the_figures_are_written_as_json_and_tidy_csv(carton, tmp_path):
    metadata = {"frame_facts": {"object_from_registration": np.eye(4).tolist(), "scale": "unknown"}}
    truth = GroundTruth.read(carton.capture, carton.model)
    quality.write_quality(
        tmp_path / "quality.json", quality.make_quality_record(carton.mesh, metadata, read_first_cameras(carton.cameras), truth)
    )
    figures = read_json(tmp_path / "quality.json")
    assert figures["scale_error_percent"] is None
    with (tmp_path / "quality.csv").open() as file:
        rows = {row["measure"]: float(row["value"]) for row in csv.DictReader(file)}
    assert rows["f_score_2_mm"] == 1.0 and "scale_error_percent" not in rows
