"""The virtual test set: things rest on the table without touching, the depth is a sensor's, the files are what BOP tools read."""

import json
from pathlib import Path

import manifold3d
import numba
import numpy as np
import pytest
import trimesh

from zeroshop_steps.bop.formats.bop_scenes import read_scene
from zeroshop_steps.bop.formats.models import model_path, read_models
from zeroshop_steps.bop.formats.targets import read_target_frames, read_targets
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.synthetic.make_test_scenes import choose_objects
from zeroshop_steps.synthetic.scenes.clutter import GAP_MM, choose_rest, make_body, place_bodies
from zeroshop_steps.synthetic.scenes.distractors import make_distractor
from zeroshop_steps.synthetic.scenes.table_scene import TILE_PX, merge_meshes


@pytest.mark.slow
def test_things_rest_on_the_table_and_keep_apart():
    rng = np.random.default_rng(0)
    solids = [trimesh.creation.box((80, 60, 30)), trimesh.creation.cylinder(30, 90), trimesh.creation.icosphere(3, 35)] * 2
    bodies = [make_body(np.asarray(solid.vertices)) for solid in solids]
    poses = place_bodies(bodies, rng)
    moved = [solid.vertices @ pose[:3, :3].T + pose[:3, 3] for solid, pose in zip(solids, poses, strict=True)]
    for vertices, pose in zip(moved, poses, strict=True):
        assert vertices[:, 2].min() == pytest.approx(0, abs=1e-6)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.hypot(*vertices[:, :2].mean(0)) < 300
    shapes = [manifold3d.Manifold.hull_points(vertices) for vertices in moved]
    for index, shape in enumerate(shapes):
        assert all(shape.min_gap(other, 10.0) > GAP_MM - 0.5 for other in shapes[:index])


def test_a_box_lies_on_one_of_its_sides():
    body = make_body(np.asarray(trimesh.creation.box((100, 70, 40)).vertices))
    rng = np.random.default_rng(1)
    heights = set()
    for _ in range(40):
        pose = choose_rest(body, rng)
        extent = np.ptp(body.vertices @ pose[:3, :3].T, axis=0)[2]
        heights.add(round(float(extent)))
    assert heights <= {100, 70, 40} and 40 in heights


def test_every_object_takes_its_turn():
    chosen = [choose_objects(list(range(1, 12)), scene, 3) for scene in range(1, 9)]
    assert all(5 <= len(set(objects)) == len(objects) <= 8 for objects in chosen)
    counts = np.bincount(np.concatenate(chosen), minlength=12)[1:]
    assert counts.max() - counts.min() <= 2
    assert choose_objects([4, 9], 1, 0) == [4, 9]


def test_merged_things_keep_their_prints():
    rng = np.random.default_rng(2)
    things = [make_distractor(rng) for _ in range(3)]
    whole = merge_meshes(things)
    assert whole.texture.shape == (2 * TILE_PX, 2 * TILE_PX, 3) and len(whole.faces) == sum(len(thing.faces) for thing in things)
    start = 0
    for thing in things:
        uv = whole.uv[start : start + len(thing.vertices)]
        ours, theirs = (
            texture[((1 - at[:, 1]) * texture.shape[0]).astype(int), (at[:, 0] * texture.shape[1]).astype(int)].astype(int)
            for texture, at in ((whole.texture, uv), (thing.texture, thing.uv))
        )
        assert np.median(np.abs(ours - theirs)) <= 2
        start += len(thing.vertices)


@pytest.fixture(scope="module")
def models(tmp_path_factory) -> Path:
    """Two textured boxes in BOP's layout."""
    folder, rng, listed = tmp_path_factory.mktemp("bop") / "models", np.random.default_rng(5), {}
    for number in (3, 8):
        mesh = next(mesh for mesh in iter(lambda: make_distractor(rng), None) if len(mesh.faces) == 12)
        path = model_path(folder, number)
        write_image(path.with_suffix(".png"), mesh.texture)
        write_ply(path, mesh, path.with_suffix(".png").name)
        listed[str(number)] = {"diameter": float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))}
    (folder / "models_info.json").write_text(json.dumps(listed))
    return folder


def make(models: Path, out: Path, seed: int) -> Path:
    words = ["--method", "make_test_scenes", "--models", models, "--scenes", 1, "--images", 1, "--width-px", 160, "--height-px", 120]
    words += ["--seed", seed, "--targets", out / "targets.json", "--camera", out / "camera.json", "--out", out / "test"]
    assert stage_main("zeroshop_steps.synthetic", ["--method", "make_test_scenes", *map(str, words)]) == 0
    return out


@pytest.fixture(scope="module")
def made(models, tmp_path_factory) -> Path:
    return make(models, tmp_path_factory.mktemp("set"), 0)


def test_what_is_written_is_a_bop_dataset(made, models):
    targets = read_targets(made / "targets.json")
    frames = read_target_frames(made / "test", targets, made / "targets.json")
    frame = frames[1, 0]
    assert {instance.object_id for instance in frame.instances} == {3, 8} and frame.size_px() == (160, 120)
    assert read_image(frame.image_path("rgb")).std() > 10
    assert json.loads((made / "camera.json").read_text())["width"] == 160
    meshes = read_models(models, [3, 8])
    measured, checked = frame.depth_mm(), []
    for index, instance in enumerate(frame.instances):
        visible = frame.mask(index)
        depth = (
            DepthRenderer(meshes[instance.object_id].mesh).render(instance.camera_from_model, frame.intrinsics, 160, 120).image(160, 120)
        )
        assert (visible <= (depth > 0)).all(), "the pose puts the model where its mask is"
        known = visible & (measured > 0)
        if instance.visible_share > 0.3:  # the rim of what is almost hidden lies in the projector's shadow
            checked.append(instance.object_id)
            assert known.sum() > 0.5 * visible.sum() and np.median(np.abs(measured - depth)[known]) < 3.0
        up = np.linalg.inv(frame.camera_from_world) @ instance.camera_from_model
        vertices = meshes[instance.object_id].mesh.vertices @ up[:3, :3].T + up[:3, 3]
        assert vertices[:, 2].min() == pytest.approx(0, abs=0.01), "it stands on the table"
    assert checked


def test_the_depth_is_a_sensors(made):
    frame = read_scene(made / "test" / "000001")[0]
    depth = frame.depth_mm()
    assert 0.001 < (depth == 0).mean() < 0.3, "it has holes"
    steps = 351_300.0 / depth[depth > 0]
    assert np.abs(steps - np.rint(steps)).mean() < 0.1, "it comes in whole steps of disparity, but for the file's own of 0.1 mm"


@pytest.mark.slow
def test_one_seed_makes_the_same_bytes_whatever_the_threads(made, models, tmp_path):
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    again = make(models, tmp_path / "again", 0)
    numba.set_num_threads(threads)
    files = sorted(path.relative_to(made) for path in made.rglob("*") if path.is_file())
    assert len(files) >= 10 and all((made / file).read_bytes() == (again / file).read_bytes() for file in files)
