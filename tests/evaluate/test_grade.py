import csv
import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from helpers import ball_scene, damage
from helpers.carton_scene import SIZE_MM, camera_at
from helpers.coarse_ground import coarse_ground
from zeroshop_steps.evaluate import photo_measures
from zeroshop_steps.evaluate.grade import judge_mesh
from zeroshop_steps.evaluate.grading import GRADES, MEASURES, grade_by_worst
from zeroshop_steps.evaluate.photo_measures import measure_photo_agreement
from zeroshop_steps.evaluate.surface_measures import (
    measure_guessed_share,
    measure_largest_part_share,
    measure_open_boundary,
    measure_roughness_deg,
)
from zeroshop_steps.geometry.alignment import surface_distance
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.imaging.images import read_image, write_image, write_mask
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.geometry.observation.support_classes import ASSUMED, MEASURED, UNSEEN, with_surface_support
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.synthetic.demo_objects import write_demo_object
from zeroshop_steps.synthetic.raycast import capture

WIDTH_PX, HEIGHT_PX = 320, 240


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(shape.vertices, float), np.array(shape.faces, np.int64))


def small_case(name: str, folder: Path) -> damage.Case:
    write_demo_object(name, folder / "model")
    with coarse_ground(1024):
        capture(folder / "model" / "model.ply", "su_h", WIDTH_PX, HEIGHT_PX, 0, folder / "capture")
    return damage.read_case(folder / "capture", folder / "model" / "model.ply")


@pytest.fixture(scope="module")
def bottle(tmp_path_factory) -> damage.Case:
    return small_case("mustard_bottle", tmp_path_factory.mktemp("bottle"))


@pytest.fixture(scope="module")
def bowl(tmp_path_factory) -> damage.Case:
    return small_case("bowl", tmp_path_factory.mktemp("bowl"))


@pytest.fixture(scope="module", autouse=True)
def fewer_samples():
    """And larger voxels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surface_distance, "SAMPLES", 10_000)
        patch.setattr(photo_measures, "SAMPLES", 2000)
        patch.setattr(damage, "fused", functools.partial(damage.fused, voxels=96))
        yield


@pytest.fixture(scope="module")
def undamaged(bottle) -> dict:
    """The grade of the bottle's fused surface: the first step of every damage is none."""
    return damage.grade_of(bottle, damage.fused(bottle))


def test_the_worst_measure_decides_and_is_named():
    limits = {"silhouette_agreement": (0.97, 0.9), "back_share": (0.02, 0.15)}
    assert grade_by_worst({"silhouette_agreement": 0.98, "back_share": 0.02}, limits) == grade_by_worst({}, limits)
    verdict = grade_by_worst({"silhouette_agreement": 0.95, "back_share": 0.01}, limits)
    assert verdict.grade == "sparse" and verdict.reasons[0].startswith("sparse: silhouette_agreement is 0.95, below 0.97")
    verdict = grade_by_worst({"silhouette_agreement": 0.95, "back_share": 0.2}, limits)
    assert verdict.grade == "none" and len(verdict.reasons) == 2
    assert verdict.reasons[1].startswith("none: back_share is 0.2, above 0.15, the limit of sparse")


def test_what_is_not_a_number_is_never_good():
    assert grade_by_worst({"roughness_deg": float("nan")}, {"roughness_deg": (9.0, 20.0)}).grade == "none"


def test_parts_are_weighed_by_area():
    cube, small = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((0.5, 0.5, 0.5))
    small.apply_translation([2, 0, 0])
    assert measure_largest_part_share(mesh_of(cube)) == 1.0
    assert measure_largest_part_share(mesh_of(trimesh.util.concatenate([cube, small]))) == pytest.approx(0.8)


def test_an_open_box_has_the_border_of_its_lid_where_photos_see_it():
    box = trimesh.creation.box((30, 40, 120)).subdivide()
    whole, diameter = mesh_of(box), 130.0
    without_top = Mesh(whole.vertices, whole.faces[box.face_normals[:, 2] < 0.5])
    without_bottom = Mesh(whole.vertices, whole.faces[box.face_normals[:, 2] > -0.5])
    around = [camera_at(f"{k}.png", 20.0 + 36.0 * k, 10.0) for k in range(10)]
    assert measure_open_boundary(whole, around, -60.0) == 0.0
    assert measure_open_boundary(without_top, around, -60.0) == pytest.approx(140 / diameter)
    assert measure_open_boundary(without_bottom, around, -60.0) == 0.0
    assert measure_open_boundary(without_bottom, around, None) == pytest.approx(140 / diameter)
    towards_x = [camera_at(f"{k}.png", -20.0 + 10.0 * k, 10.0) for k in range(2)]
    assert measure_open_boundary(without_top, towards_x, -60.0) < 120 / diameter


def test_roughness_grows_with_noise_and_leaves_edges_out():
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=50.0)
    noise = np.random.default_rng(0).normal(size=len(sphere.vertices))[:, None] * sphere.vertex_normals
    angles = [
        measure_roughness_deg(Mesh(np.array(sphere.vertices + size * noise), np.array(sphere.faces, np.int64))) for size in (0.0, 0.1, 0.3)
    ]
    assert angles[0] < 2.0 and angles[0] < angles[1] < angles[2]
    assert measure_roughness_deg(mesh_of(trimesh.creation.box((1, 2, 3)))) < 0.1


def test_what_nothing_measured_counts_where_the_masks_leave_room():
    """A ball, a third of it assumed: as it is, it lies on the hull of its masks; with a dent there, nothing says how deep it is."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=ball_scene.RADIUS)
    side = ball.vertices @ [1.0, 0.0, 0.2] > 0.35 * ball_scene.RADIUS
    quality = np.where(side, ASSUMED, MEASURED) / MEASURED
    views = [
        damage.MemoryView(camera, Path(), None, np.zeros((camera.height_px, camera.width_px, 3), np.uint8), ball_scene.ball_mask(camera))
        for camera in ball_scene.ball_cameras()
    ]
    depth = 0.3 * np.exp(-((np.linalg.norm(ball.vertices - [ball_scene.RADIUS, 0, 0], axis=1) / 0.3) ** 2))
    dented = ball.vertices * (1.0 - depth[:, None])
    whole, hollow = (replace(mesh_of(ball), vertices=np.array(shape), quality=quality) for shape in (ball.vertices, dented))
    assert measure_guessed_share(whole, views) == 0.0
    assert 0.03 < measure_guessed_share(hollow, views) < 0.15
    assert measure_guessed_share(replace(hollow, quality=np.ones(len(side))), views) == 0.0


def test_photos_agree_on_the_true_surface_and_not_on_another(carton):
    views, _ = read_views(carton.cameras)
    truth = measure_photo_agreement(carton.mesh, views)
    assert truth.silhouette_agreement > 0.99 and truth.back_share == 0.0
    assert truth.displaced_share < 0.01 and truth.photometric_error < 0.03 and truth.judged_share > 0.5
    larger = measure_photo_agreement(Mesh(carton.mesh.vertices * 1.15, carton.mesh.faces), views)
    assert larger.displaced_share > 0.2 and larger.photometric_error > 2 * truth.photometric_error
    assert larger.silhouette_agreement < 0.9
    turned = measure_photo_agreement(Mesh(carton.mesh.vertices, carton.mesh.faces[:, ::-1].copy()), views)
    assert turned.back_share == 1.0


@pytest.mark.slow
def test_the_lid_of_a_visual_hull_is_found_by_photos_alone(bowl):
    """The hull's silhouettes are perfect and it is smooth; only the photos of the hollow tell."""
    hull = damage.grade_of(bowl, damage.visual_hull(bowl))
    assert hull["photos"]["grade"] != "good" and hull["truth"]["grade"] != "good"
    assert hull["photos"]["measures"]["silhouette_agreement"] > 0.97
    assert [reason.split()[1] for reason in hull["photos"]["reasons"]] == ["displaced_share"]
    true_surface = damage.grade_of(bowl, bowl.truth)
    assert true_surface["grade"] == true_surface["photos"]["grade"] == "good"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["camera noise, degrees", "views kept of 20", "bite out of the masks", "cropped from the top", "smoothing steps"]
)
def test_the_grade_falls_in_order_with_damage(bottle, undamaged, name):
    """Three of six steps here; the command of damage.py shows all of them, and other objects."""
    graded = [undamaged, *(content for _, _, content in damage.graded_damages(bottle, [name], numbers=(2, 5)))]
    for side in ("photos", "truth"):
        order = [GRADES.index(content[side]["grade"]) for content in graded]
        assert order == sorted(order, reverse=True)
        assert order[0] == GRADES.index("good") and order[-1] < order[0]
    assert graded[-1]["photos"]["grade"] == "none"


@pytest.mark.slow
def test_few_photos_are_no_good_even_if_all_have_their_cameras(bottle, undamaged):
    graded = [undamaged, *(content for _, _, content in damage.graded_damages(bottle, ["photos taken of 20"], numbers=(5,)))]
    assert [content["photos"]["grade"] for content in graded] == ["good", "sparse"]
    assert GRADES.index(graded[-1]["truth"]["grade"]) < GRADES.index("good")


def evaluate(*arguments: object) -> int:
    return stage_main("zeroshop_steps.evaluate", [str(argument) for argument in ("--method", "finished_mesh", *arguments)])


@pytest.fixture
def product(carton, tmp_path) -> Path:
    write_image(tmp_path / "mesh.png", carton.mesh.texture)
    write_ply(tmp_path / "mesh.ply", carton.mesh, "mesh.png")
    facts = {"object_from_registration": np.eye(4).tolist(), "scale": "known", "bottom_z": -45.0}
    write_json(tmp_path / "mesh.json", {"frame_facts": facts})
    write_json(carton.cameras / "registration.json", {"status": "ok", "images": 10})
    return tmp_path / "mesh.ply"


def test_the_command_grades_by_photos_and_where_it_can_by_the_truth(carton, product):
    out = product.with_name("grade.json")
    options = ["--mesh", product, "--cameras", carton.cameras, "--out", out, "--guessed-share", 0.1, 0.2]
    assert evaluate(*options) == 0
    assert read_json(out)["grade"] == "none" and "assumed_share" in read_json(out)["reasons"][0], "no stereo confirmed it"
    options += ["--assumed-share", 0.7, 0.8]
    assert evaluate(*options) == 0
    content = read_json(out)
    assert content["grade"] == "good" and content["judged_by"] == "photos" and content["truth"] is None
    assert not product.with_name("quality.json").exists() and read_image(product.with_name("mesh_preview.png")).shape == (960, 1600, 3)
    evidence = with_surface_support(read_ply(product), product.with_name("evidence.npz"))
    assert 0.1 < evidence.measured_faces().mean() < 0.6, "its edges"
    assert evaluate(*options, "--model", carton.model.parent, "--capture", carton.capture, "--f-score-1-percent", 1.5, 0.9) == 0
    content = read_json(out)
    assert content["grade"] == "sparse" and content["judged_by"] == "truth" and content["photos"]["grade"] == "good"
    with out.with_suffix(".csv").open() as file:
        rows = {row["measure"]: row for row in csv.DictReader(file)}
    assert rows["grade"]["value"] == "sparse" and "f_score_1_percent is 1" in rows["grade"]["reason"]
    assert rows["grade_by_photos"]["value"] == "good" and float(rows["registered_share"]["value"]) == 1.0
    assert read_json(product.with_name("quality.json"))["f_score_1_percent"] == 1.0


def test_limits_in_the_wrong_order_are_refused(carton, product, capsys):
    out = product.with_name("grade.json")
    assert evaluate("--mesh", product, "--cameras", carton.cameras, "--out", out, "--back-share", 0.2, 0.1) == 1
    assert "finish.grade.back_share is [0.2, 0.1]; the limit of good comes first" in capsys.readouterr().err
    assert not out.exists()


def test_a_record_names_the_part_that_failed(carton, product):
    out, quality = product.with_name("grade.json"), product.with_name("quality.json")
    words = ["--mesh", product, "--cameras", carton.cameras, "--model", product.parent / "none", "--capture", carton.capture, "--out", out]
    assert evaluate(*words, "--record-failure", out, quality) == 0
    failure = read_failure(out)
    assert failure is not None and failure.step == "evaluate.quality" and "none/model.ply does not exist" in failure.reason
    assert read_failure(quality) == failure


def test_an_empty_mask_is_named(carton, tmp_path):
    views, _ = read_views(carton.cameras)
    write_mask(tmp_path / "empty.png", np.zeros((240, 320), bool))
    views[3] = type(views[3])(views[3].camera, views[3].image_path, tmp_path / "empty.png")
    with pytest.raises(StepError, match=r"empty\.png: the mask shows no object"):
        measure_photo_agreement(carton.mesh, views)


def test_a_surface_that_nothing_measured_is_not_good(carton):
    """The same mesh, once measured all over and once assumed but for a few sides; its underside counts for neither."""
    views, _ = read_views(carton.cameras)
    mesh = carton.mesh
    lower = mesh.vertices[mesh.faces].mean(1)[:, 2] < -0.49 * SIZE_MM[2]
    faces = np.concatenate([mesh.faces[~lower], mesh.faces[lower]])
    frame = {"object_from_registration": np.eye(4).tolist(), "bottom_z": -SIZE_MM[2] / 2}
    metadata = {"frame_facts": frame, "underside": {"first_face": int((~lower).sum()), "faces": int(lower.sum())}}
    limits = {measure.name: (measure.good, measure.sparse) for measure in MEASURES}
    shares = []
    for kind in (MEASURED, ASSUMED):
        evidence = np.where(mesh.vertices[:, 0] > 0, kind, MEASURED).astype(np.uint8)
        evidence[mesh.vertices[:, 2] < -0.49 * SIZE_MM[2]] = UNSEEN
        supported = replace(mesh, faces=faces, quality=evidence / MEASURED)
        photos = judge_mesh(supported, metadata, views, len(views), None, limits)["photos"]
        shares.append(photos["measures"]["assumed_share"])
    assert shares[0] == 0.0 and 0.4 < shares[1] < 0.6
    assert photos["grade"] != "good" and any("assumed_share" in reason for reason in photos["reasons"])


def test_a_mesh_whose_masks_contradict_each_other_is_not_usable(carton):
    views, _ = read_views(carton.cameras)
    metadata = {"frame_facts": {"bottom_z": -SIZE_MM[2] / 2}}
    limits = {measure.name: (measure.good, measure.sparse) for measure in MEASURES}
    mesh = replace(carton.mesh, quality=np.ones(len(carton.mesh.vertices)))
    for missed_px, grade in ((None, "good"), (1.4, "good"), (5.0, "sparse"), (12.0, "none")):
        photos = judge_mesh(mesh, metadata, views, len(views), None, limits, missed_px)["photos"]
        assert photos["grade"] == grade, photos["reasons"]
    assert "outlines_miss_px is 12, above 8, the limit of sparse" in photos["reasons"][0]
