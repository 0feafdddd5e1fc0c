"""A printed box is found again, print side and all, from its depth and colours, half of it hidden or not."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from helpers.printed_box import INTRINSICS, make_box, taken, view
from zeroshop_steps.bop.formats.bop_scenes import read_scene
from zeroshop_steps.bop.formats.estimates import read_estimates
from zeroshop_steps.bop.formats.models import ObjectModel, read_models
from zeroshop_steps.bop.scoring.pose_error import ModelPoints, mssd
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer, sample_texture
from zeroshop_steps.pose.icp import run_icp
from zeroshop_steps.pose.pose_score import PoseScorer, cut_patch
from zeroshop_steps.pose.render_compare import PreparedModel, collect_points, estimate_pose
from zeroshop_steps.runtime.cli import stage_main


@pytest.fixture(scope="module")
def model() -> ObjectModel:
    return make_box()


@pytest.fixture(scope="module")
def ready(model) -> PreparedModel:
    return PreparedModel(model)


@pytest.mark.parametrize(("seed", "hidden"), [(1, False), (2, True)])
def test_a_box_is_found_again(model, ready, seed, hidden):
    pose, photo, depth, mask = view(model, seed, hidden)
    found = estimate_pose(mask, photo, depth, INTRINSICS, ready)
    error_mm = mssd(found.camera_from_model[None], pose[None], ModelPoints.from_vertices(model.mesh.vertices), model.symmetries)[0]
    assert error_mm < 0.05 * model.diameter_mm and 0.5 < found.explained <= 1.0
    assert found.points > 0.99 * (mask & (depth > 0)).sum()


def test_a_pose_that_shows_another_side_explains_less(model, ready):
    pose, photo, depth, mask = view(model, 1, False)
    patch = cut_patch(photo, depth, mask, INTRINSICS)
    turned, moved = pose.copy(), pose.copy()
    turned[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec([0, 0, np.pi]).as_matrix()
    moved[:3, 3] += [0, 0, 8]
    true, other_side, farther = ready.comparison.score(np.stack([pose, turned, moved]), patch)
    assert true > other_side + 0.1, "the shape is the same, the print is not"
    assert true > farther + 0.1, "8 mm are seen"


@pytest.mark.parametrize("form", ["vertex colours", "no colour"])
def test_a_model_without_a_texture_is_found(model, form):
    """Colours at the vertices tell sides apart; without any, shape alone decides, up to the box's symmetries."""
    mesh = subdivided(model.mesh, 5)
    pose, photo, depth, mask = view(model, 1, False)
    bare = replace(mesh, uv=None, texture=None, colors=None)
    plain = replace(model, mesh=mesh if form == "vertex colours" else bare)
    found = estimate_pose(mask, photo, depth, INTRINSICS, PreparedModel(plain))
    turns = np.stack([np.diag([a, b, a * b, 1.0]) for a in (1, -1) for b in (1, -1)])
    symmetries = turns[:1] if form == "vertex colours" else turns
    error_mm = mssd(found.camera_from_model[None], pose[None], ModelPoints.from_vertices(mesh.vertices), symmetries)[0]
    assert error_mm < 0.05 * model.diameter_mm


@pytest.mark.slow
def test_a_published_model_with_colours_at_its_vertices_is_found(shared_data, tmp_path):
    """A basket of TYO-L in a real photo."""
    published = shared_data / "reports/tyol"
    if not published.is_dir():
        pytest.skip(f"{published} is not there")
    scene, masked = tmp_path / "test/000019", published / "test_with_masks/000019"
    for folder in (published / "test/000019/rgb", published / "test/000019/depth", masked / "mask_visib"):
        shutil.copytree(folder, scene / folder.name)
    for path in masked.glob("*.json"):
        shutil.copy(path, scene)
    places = {"models": published / "models", "scenes": scene.parent, "targets": published / "test_targets_bop19.json"}
    words = [word for name, place in places.items() for word in (f"--{name}", str(place))]
    assert stage_main("zeroshop_steps.pose", ["--method", "render_compare", *words, "--out", str(tmp_path / "poses.csv")]) == 0
    model, found = read_models(published / "models", [19])[19], read_estimates(tmp_path / "poses.csv")
    (truth,) = read_scene(scene)[10].instances
    estimated = np.eye(4)
    estimated[:3] = np.concatenate([found.rotations[0], found.translations_mm[0][:, None]], axis=1)
    error_mm = mssd(estimated[None], truth.camera_from_model[None], ModelPoints.from_vertices(model.mesh.vertices), model.symmetries)[0]
    assert model.diameter_mm == pytest.approx(253.3, abs=0.1) and error_mm < 0.05 * model.diameter_mm


def subdivided(mesh: Mesh, times: int) -> Mesh:
    """A textured mesh of many small faces with the texture's colours at its vertices instead."""
    faces, data = mesh.faces, np.concatenate([mesh.vertices, mesh.uv], 1)
    for _ in range(times):
        data, faces = trimesh.remesh.subdivide(data, faces)
    return Mesh(data[:, :3], faces, colors=np.clip(np.rint(sample_texture(mesh.texture, data[:, 3:])), 0, 255).astype(np.uint8))


def test_print_that_no_photo_saw_counts_neither_for_a_pose_nor_against_it(model):
    """The mesh's last side is grey, as a closed underside is; the photo shows that side, printed."""
    mesh = model.mesh
    normal = mesh.normals[mesh.faces[0, 0]]
    last = np.flatnonzero(mesh.normals[mesh.faces[:, 0]] @ normal > 0.99)
    faces = np.concatenate([np.delete(mesh.faces, last, 0), mesh.faces[last]])
    uv = mesh.uv * [0.5, 1.0]
    uv[mesh.faces[last].ravel()] += [0.5, 0.0]
    grey = Mesh(mesh.vertices, faces, mesh.normals, uv, np.concatenate([mesh.texture, np.full_like(mesh.texture, 128)], 1))
    quality = np.ones(len(mesh.vertices))
    quality[mesh.faces[last].ravel()] = 0.0
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.align_vectors([[0.3, 0.2, -1.0]], [normal])[0].as_matrix(), [8, -5, 700]
    photo, depth, mask = taken(model, pose, np.random.default_rng(1))
    patch = cut_patch(photo, depth, mask, INTRINSICS)
    turned = pose.copy()
    turned[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(np.pi * normal).as_matrix()
    known, marked = (PoseScorer(mesh).score(np.stack([pose, turned]), patch) for mesh in (grey, replace(grey, quality=quality)))
    assert marked[0] > known[0] + 0.02
    assert marked[0] > marked[1]


@pytest.mark.slow
def test_a_hollow_behind_a_lid_that_was_assumed_is_allowed_for():
    """The mesh of an open box keeps a lid; the box lies with its opening towards the camera."""
    box = trimesh.creation.box((120, 80, 60))
    closed = Mesh(np.array(box.vertices), np.array(box.faces))
    lid = closed.vertices[closed.faces].mean(1)[:, 2] > 29
    flat = Mesh(closed.vertices[closed.faces].reshape(-1, 3), np.arange(3 * len(closed.faces)).reshape(-1, 3))
    lidded = replace(flat, quality=np.where(np.repeat(lid, 3), 0.5, 1.0))
    open_box = trimesh.creation.box((120, 80, 60)).difference(trimesh.creation.box((112, 72, 60)).apply_translation([0, 0, 4]))
    true = Mesh(np.array(open_box.vertices), np.array(open_box.faces))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("xyz", [160, 15, 30], degrees=True).as_matrix(), [8, -5, 700]
    camera = Camera("", 160, 120, INTRINSICS + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]), pose)
    depth = MeshRenderer(true).cast_rays(camera).depth
    mask, photo = depth > 0, np.full((120, 160, 3), 128, np.uint8)
    depth = np.where(mask, depth, 950.0).astype(np.float32)
    diameter_mm = float(np.linalg.norm((120, 80, 60)))
    errors_mm, explained = [], []
    for mesh in (flat, lidded):
        found = estimate_pose(mask, photo, depth, INTRINSICS, PreparedModel(ObjectModel(1, mesh, diameter_mm, np.eye(4)[None], {})))
        turned = np.diag([-1.0, -1.0, 1.0, 1.0])
        alike = np.stack([np.eye(4), turned])
        errors_mm.append(mssd(found.camera_from_model[None], pose[None], ModelPoints.from_vertices(true.vertices), alike)[0])
        explained.append(found.explained)
    assert errors_mm[1] < 0.08 * diameter_mm < errors_mm[0]
    assert explained[1] > explained[0] + 0.1


def test_steps_bring_a_pose_nearly_there_and_do_not_depend_on_the_others(model, ready):
    pose, _, depth, mask = view(model, 1, False)
    points = collect_points(mask, depth, INTRINSICS, model.diameter_mm)[:300]
    start = pose.copy()
    start[:3, :3] = Rotation.from_rotvec([0.1, -0.08, 0.05]).as_matrix() @ pose[:3, :3]
    start[:3, 3] += [6, -5, 9]
    both = run_icp(np.stack([start, pose]), points, ready.search._surface, 20)
    np.testing.assert_array_equal(both[:1], run_icp(start[None], points, ready.search._surface, 20))
    apart_mm = mssd(both, np.stack([pose, pose]), ModelPoints.from_vertices(model.mesh.vertices), model.symmetries)
    assert (apart_mm < 0.04 * model.diameter_mm).all()


def test_nothing_measured_means_no_estimate(model, ready):
    _, photo, depth, mask = view(model, 1, False)
    assert estimate_pose(mask, photo, np.zeros_like(depth), INTRINSICS, ready) is None
    assert len(collect_points(mask, depth, INTRINSICS, model.diameter_mm)) > 100
