"""Registration by Depth Anything 3: its geometry with a network that knows the truth, everything else with small random weights."""

import shutil
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
import torch
from safetensors.torch import load_file, save_file
from scipy.spatial.transform import Rotation

from helpers.camera_ring import ring_camera
from helpers.small_da3 import SETTINGS, write_weights
from helpers.small_vggt import TrueNetwork
from zeroshop_steps import methods
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.networks.da3.settings import BASE, SMALL
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, look_up_weights
from zeroshop_steps.register import pipeline
from zeroshop_steps.register.colmap import ColmapOptions
from zeroshop_steps.register.da3.options import Da3Options
from zeroshop_steps.register.da3.refinement import RoughScene, find_near, gather_tracks, measure_share, start_from_cameras
from zeroshop_steps.register.da3.solve import WIDTH_OF, Da3Network, find_size, predict_peak_bytes, register
from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.matching.network_matches import write_matches
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.register.scene.record import RegistrationFailed
from zeroshop_steps.register.vggt.feed_forward import decode_cameras
from zeroshop_steps.register.vggt.frames import Frames, fit_size, read_frames
from zeroshop_steps.register.vggt.memory import CHUNKS
from zeroshop_steps.runtime.cli import stage_main

PX = (SMALL.image_px, SMALL.patch_px)


def having(features: int, refine: str = "matches") -> Da3Options:
    """Options with so many features of an image."""
    return Da3Options(refine=refine, colmap=ColmapOptions(SiftOptions(max_features=features)))


@pytest.fixture(scope="module")
def frames(carton_capture):
    return read_frames(read_image_set(carton_capture), *PX, upright=True)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return write_weights(tmp_path_factory.mktemp("da3") / "weights" / "model.safetensors")


def solved(capture, out, options, network):
    record = register(read_image_set(capture), out, options, network, *PX, {})
    truth = read_sparse_model(capture / "truth").cameras
    return record, compare_cameras(read_sparse_model(out / "sparse").cameras, truth)


@pytest.mark.slow
def test_matches_and_rough_cameras_give_the_true_cameras(carton_capture, frames, tmp_path, monkeypatch):
    network = TrueNetwork(carton_capture, frames, turn_deg=3.0, fov_error=0.02, depth_error=0.01)
    rough = decode_cameras(network.predict(frames.pixels).encodings, frames)
    before = compare_cameras(rough, read_sparse_model(carton_capture / "truth").cameras)
    assert before.centre_mm.mean() > 5.0 and before.rotation_deg.max() > 2.0
    monkeypatch.setattr(pipeline, "map_incrementally", lambda *_: pytest.fail("not from the network's cameras"))
    record, after = solved(carton_capture, tmp_path / "cameras", having(1000), network)
    assert record["registered"] == 10 and record["refined_by"] == "matches" and not record["strangers"]
    assert after.centre_mm.mean() < 0.3 and after.rotation_deg.max() < 0.1
    assert record["reprojection_error_px"] < 0.5 and "sharpened" in record and record["consistency"]["weakest_cut_matches"] > 60


@pytest.mark.slow
def test_where_too_little_matches_the_networks_cameras_are_taken(carton_capture, frames, tmp_path):
    network = TrueNetwork(carton_capture, frames, turn_deg=0.2, fov_error=0.002, depth_error=0.003)
    expected = decode_cameras(TrueNetwork(carton_capture, frames, turn_deg=0.2, fov_error=0.002).predict(frames.pixels).encodings, frames)
    record, error = solved(carton_capture, tmp_path / "cameras", having(10), network)
    assert record["registered"] == 10 and record["refined_by"] == "none"
    assert "matches hold 0 of 10 images, at least 8 are needed" in record["warnings"][0]
    assert min(record["consistency"]["depth_agreement"].values()) > 0.8 and 0.0 < error.rotation_deg.max() < 0.5
    for ours, theirs in zip(read_sparse_model(tmp_path / "cameras/sparse").cameras, expected, strict=True):
        assert np.allclose(ours.camera_from_world, theirs.camera_from_world) and np.allclose(ours.intrinsics, theirs.intrinsics)


def test_tracks_are_what_matches_connect_in_three_images(blank_capture, tmp_path):
    image_set = read_image_set(blank_capture)
    keypoints = [np.array([[10.0 * point, image] for point in range(5)]) for image in range(len(image_set.images))]
    database = tmp_path / "database.db"
    every = np.stack([np.arange(5)] * 2, axis=1)
    write_matches(database, image_set, keypoints, {(0, 1): (every[:, 0], every[:, 1])}, 1, 0)
    with pycolmap.Database.open(database) as opened:
        opened.clear_two_view_geometries()
        ids = [opened.read_image_with_name(name).image_id for name in image_set.names]
        # Point 0 is in four images, 1 in three; 2 in three, and there it is two places of one image; 3 in two; 4 in none.
        for first, second, matched in (
            (0, 1, every[:4]),
            (1, 2, np.array([[0, 0], [1, 1], [2, 2]])),
            (0, 2, np.array([[2, 3]])),
            (2, 3, every[:1]),
        ):
            opened.write_two_view_geometry(ids[first], ids[second], pycolmap.TwoViewGeometry(inlier_matches=matched.astype(np.uint32)))
    tracks = gather_tracks(database, image_set.names)
    assert tracks.seen[:4].T.astype(int).tolist() == [[1, 1, 1, 1], [1, 1, 1, 0]] and not tracks.seen[4:].any()
    assert tracks.xy[:4].tolist() == [[[0, 0], [10, 0]], [[0, 1], [10, 1]], [[0, 2], [10, 2]], [[0, 3], [0, 0]]]


RADIUS_MM, RING, SEEN_PX, SMALL_PX = 60.0, 10, (320, 240), (160, 120)


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """Ten cameras around a ball with 600 points, blank pictures of it, its depth, and a database of the matches of what both see."""
    folder, rng = tmp_path_factory.mktemp("ball"), np.random.default_rng(0)
    cameras = [ring_camera(index, RING, 400.0, (35.0, 15.0), (0.0, 0.0, 0.0), 400.0, SEEN_PX) for index in range(RING)]
    points = rng.normal(size=(600, 3))
    points *= RADIUS_MM / np.linalg.norm(points, axis=1, keepdims=True)
    for camera in cameras:
        write_image(folder / "images" / camera.name, np.full((SEEN_PX[1], SEEN_PX[0], 3), int(camera.name[:6]), np.uint8))
    names = tuple(camera.name for camera in cameras)
    frames = Frames(names, np.zeros((RING, 3, SMALL_PX[1], SMALL_PX[0]), np.float32), SEEN_PX, np.array([0.5, 0.5]), 0)
    xy = frames.to_image(np.stack(np.meshgrid(*map(np.arange, SMALL_PX)), axis=2).reshape(-1, 2).astype(float))
    scene = RoughScene(cameras, frames, np.array([ball_depth(camera, xy).reshape(SMALL_PX[::-1]) for camera in cameras]))
    seen = [points @ camera.centre_in_world > 3 * RADIUS_MM**2 for camera in cameras]
    keypoints = [camera.project(points)[0] + 0.1 * rng.normal(size=(600, 2)) for camera in cameras]
    pairs = {
        (one, other): (np.flatnonzero(seen[one] & seen[other]),) * 2
        for one in range(RING)
        for other in range(one + 1, RING)
        if (seen[one] & seen[other]).sum() > 20
    }
    image_set = read_image_set(folder)
    write_matches(folder / "database.db", image_set, keypoints, pairs, 3, 0)
    return image_set, scene, folder / "database.db"


def ball_depth(camera: Camera, xy: np.ndarray) -> np.ndarray:
    """(N,) depth of the ball at (N, 2) positions, 0 off it."""
    rays = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(camera.intrinsics).T
    middle = camera.camera_from_world[:3, 3]
    along, square = rays @ middle, (rays**2).sum(1)
    inside = along**2 - square * (middle @ middle - RADIUS_MM**2)
    return np.where(inside > 0, (along - np.sqrt(np.maximum(inside, 0))) / square, 0.0)


def moved(scene: RoughScene, turn_deg: float) -> RoughScene:
    """The scene with its cameras turned at random about axes through the world's origin."""
    turns = Rotation.from_rotvec(np.radians(turn_deg) * np.random.default_rng(1).normal(size=(RING, 3)) / np.sqrt(3)).as_matrix()
    poses = [camera.camera_from_world.copy() for camera in scene.cameras]
    for pose, turn in zip(poses, turns, strict=True):
        pose[:3, :3] = pose[:3, :3] @ turn
    return replace(scene, cameras=[replace(camera, camera_from_world=pose) for camera, pose in zip(scene.cameras, poses, strict=True)])


def copied(database, folder):
    """A copy, since matches are taken out of it."""
    return shutil.copy(database, folder / "database.db")


def test_a_camera_on_the_wrong_side_is_placed_by_the_others(ball, tmp_path):
    image_set, true, database = ball
    rough = moved(true, 3.0)
    rough.cameras[3] = replace(rough.cameras[3], camera_from_world=true.cameras[8].camera_from_world)
    assert compare_cameras(rough.cameras, true.cameras).centre_mm.max() > 100
    model, entries = start_from_cameras(rough, image_set, Da3Options(max_error_px=2.0), copied(database, tmp_path))
    found = [
        replace(camera, camera_from_world=np.vstack([model.find_image_with_name(camera.name).cam_from_world().matrix(), [0, 0, 0, 1]]))
        for camera in true.cameras
        if camera.name in {image.name for image in model.images.values() if image.has_pose}
    ]
    kept = [camera for camera in true.cameras if camera.name in {one.name for one in found}]
    assert len(found) >= 9 and compare_cameras(found, kept).centre_mm.max() < 2.0
    assert 0.3 < entries["near_share"] < 0.9


def test_matches_of_places_that_lie_apart_are_told(ball, tmp_path):
    image_set, true, database = ball
    near = find_near(database, true)
    assert measure_share(near) > 0.98 and measure_share({(1, 2): np.zeros(0, bool)}) == 0
    path = copied(database, tmp_path)
    with pycolmap.Database.open(path) as opened:
        geometry = opened.read_two_view_geometry(1, 2)
        geometry.inlier_matches = np.stack([geometry.inlier_matches[:, 0], np.roll(geometry.inlier_matches[:, 1], 7)], axis=1)
        opened.update_two_view_geometry(1, 2, geometry)
    wrong = find_near(path, true)
    assert wrong[1, 2].mean() < 0.7 and all((wrong[pair] == near[pair]).all() for pair in near if pair != (1, 2))
    tracks = gather_tracks(path, image_set.names, {pair: kept & (pair != (1, 2)) for pair, kept in near.items()})
    expected = gather_tracks(database, image_set.names, {pair: kept & (pair != (1, 2)) for pair, kept in near.items()})
    assert expected.seen.any() and np.array_equal(tracks.seen, expected.seen) and np.array_equal(tracks.xy, expected.xy)


def test_cameras_that_most_matches_contradict_are_refused(ball, tmp_path):
    image_set, true, database = ball
    order = [7 * index % RING for index in range(RING)]
    cameras = [replace(true.cameras[other], name=own.name) for own, other in zip(true.cameras, order, strict=True)]
    shuffled = replace(true, cameras=cameras)
    with pytest.raises(RegistrationFailed, match="the network's cameras contradict .*% of the matches, which connect 10 of 10 images"):
        start_from_cameras(shuffled, image_set, Da3Options(), copied(database, tmp_path))


@pytest.mark.parametrize(("size_px", "expected"), [((1000, 750), (504, 378)), ((750, 1000), (378, 504)), ((640, 640), (504, 504))])
def test_upright_images_stay_upright(size_px, expected):
    assert fit_size(size_px, *PX, upright=True) == (expected, 0)


@pytest.mark.parametrize(("method", "settings"), [("da3", SMALL), ("da3_base", BASE)])
def test_the_rules_ask_for_the_memory_of_twenty_images(method, settings):
    declared = methods.REGISTRATIONS[method]
    needed = predict_peak_bytes(settings, look_up_weights(declared.weights[0]).size_bytes, 20, (504, 378), CHUNKS["cuda"][0], False)
    assert needed < 1e6 * declared.mem_mb


def run(capture, out, *words) -> int:
    words = ("--capture", capture, "--scene", "su_h", "--out", out, "--device", "cpu", *words)
    return stage_main("zeroshop_steps.register", [str(word) for word in words])


def test_bad_weights_are_refused_by_name(blank_capture, weights, tmp_path, capsys):
    state = load_file(weights)
    assert all(name.startswith("model.") for name in state)
    less = {name: tensor for name, tensor in state.items() if "cam_dec.fc_t" not in name}
    for name, content, expected in (
        ("less", less, "cam_dec.fc_t.weight"),
        ("more", {**state, "model.gs_head.weight": torch.zeros(1)}, "gs_head.weight"),
    ):
        path = tmp_path / f"{name}.safetensors"
        save_file(content, path)
        path.with_suffix(".settings.json").write_text(weights.with_suffix(".settings.json").read_text())
        assert run(blank_capture, tmp_path / "cameras", "--method", "da3", "--weights", path) == 1
        assert expected in capsys.readouterr().err and not (tmp_path / "cameras").exists()


@pytest.mark.parametrize("name", ["da3", "da3_base"])
def test_the_published_weights_are_asked_for_with_their_licence(blank_capture, tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    file = methods.REGISTRATIONS[name].weights[0]
    words = ("--weights", WEIGHTS_FOLDER / file) if methods.REGISTRATIONS[name].preset else ()
    assert run(blank_capture, "cameras", "--method", "da3", *words) == 1
    message = capsys.readouterr().err
    assert f"resources/weights/{file}" in message and "Apache-2.0" in message and "colmap needs no weights" in message


def test_a_pass_in_bfloat16_is_near_that_in_float32(weights):
    pixels = np.random.default_rng(0).random((3, 3, 42, 70), dtype=np.float32)
    exact, rough = (Da3Network(weights, SETTINGS, "cpu", precision, 2).predict(pixels) for precision in (torch.float32, torch.bfloat16))
    assert not np.array_equal(exact.depth, rough.depth) and np.allclose(exact.depth, rough.depth, rtol=0.1)
    assert np.allclose(exact.encodings, rough.encodings, atol=0.05)


def test_settings_fit_the_patches():
    for settings in (SMALL, BASE, SETTINGS):
        assert settings.image_px % settings.patch_px == 0 and settings.width % (4 * settings.heads) == 0
        assert settings.layers[0] >= settings.alone and all(layer % 2 == 1 for layer in settings.layers)


def test_the_size_of_a_checkpoint_is_read_from_it(weights, tmp_path):
    for width, settings in ((BASE.width, BASE), (SMALL.width, SMALL)):
        path = tmp_path / f"{width}.safetensors"
        save_file({"model.backbone.pretrained.cls_token": torch.zeros(1, 1, width)}, path)
        assert find_size(path) == settings
    assert [name for name in load_file(weights) if name.endswith(WIDTH_OF)], "as the network has it"
    (tmp_path / "damaged.safetensors").write_bytes(b"{}")
    assert find_size(tmp_path / "damaged.safetensors") == SMALL
